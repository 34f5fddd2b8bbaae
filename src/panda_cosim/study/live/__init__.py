"""A co-simulation in real time in the browser: several can watch, one can act.

`simulation` steps a `Session` in real time and carries out commands between two rows,
`server` serves the page and carries rows and commands, `page` makes the page. The page's own code
is in `src/panda_cosim/show/view/source/src/live`.
"""
