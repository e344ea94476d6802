"""The room tour: a scanned room relit live in the browser.

`plan` is what visitors set up; `sky` gives its daylight, `lighting` its lights, `editable_scene` its surface with
moved furniture, `uncovered` what no longer stands before it. `renderer` renders frames of it, and `render_queue`
does so for each visitor's latest request.
`messages` are those of the page (`hyjax/device/page/`), `page_files` its files, `visitor` one page that is open,
`wire` the server, and `tour` puts them together.
"""
