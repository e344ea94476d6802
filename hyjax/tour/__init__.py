"""The room tour: a scanned room relit live in the browser.

`plan` is what viewers set up; `sky` gives its daylight, `lighting` its lights, `editable_scene` its surface with
moved furniture. `renderer` renders frames of it, and `render_queue` does so for each viewer's latest request.
`session` is the state that all viewers share, `viewer` one browser, and `page` serves them all.
"""
