"""A co-simulation in real time in the browser: several can watch, one can act.

`simulation` steps a `Session` in real time and carries out commands between two rows,
`server` serves the page and carries rows and commands, `page` makes the page. `alone` and
`criteria` are for a page that simulates by itself. The pages' own code is in
`src/panda_cosim/result/view/source/src`, in `live` and `engine`.
"""
