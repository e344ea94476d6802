"""The room tour: a scanned room relit live in the browser.

`sky` knows where the sun stands, `plan` what a person has set up, `lighting` the lights that it makes, `house` the
surface that it leaves; `studio` paints a view of it, `easel` keeps the painting up with the changes, `page` is what
the browser shows.
"""
