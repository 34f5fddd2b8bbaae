"""Runs the command line as `python -m panda_cosim`."""

import sys

# `python -m` puts the working directory first on sys.path, so a json.py there would be imported.
if not sys.flags.safe_path:
    del sys.path[0]

from panda_cosim.cli import main

main()
