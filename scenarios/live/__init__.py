"""A co-simulation in real time in the browser: seen by several, acted on by one.

`simulation` steps a `Session` against the clock and does what it is told between two rows,
`server` serves the page and carries rows and commands, `page` makes the page. The page's own code
is in `scenarios/view/source/src/live`.
"""
