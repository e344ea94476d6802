"""The room tour: a scanned room relit live in the browser.

`sky` knows where the sun stands, `plan` what a person has set up, `studio` paints a view of it, `easel` keeps the
painting up with the changes, `page` is what the browser shows.
"""
