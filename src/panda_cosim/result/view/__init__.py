"""Runs in 3D in the browser: one page that needs no network, drawn from recordings alone."""
