"""Runs in 3D in the browser: one page that needs no network, drawn from recordings alone.

`export.write_view` writes the page; `run.describe` and `model.describe` make what a page of
another kind (a report) embeds. The page's own code is in `source` (TypeScript); what is built of
it, `page/view.js` and `page/view.css`, ships with the licences of the libraries in it.
"""
