"""Runs in 3D in the browser: one page that needs no network, drawn from recordings alone.

`export.write_view` writes the page; `run.describe` and `model.describe` make the data that
other pages (reports) embed. The page's own code is in `source` (TypeScript); the code built from
it, `page/view.js` and `page/view.css`, ships with the licences of the libraries in it.
"""
