"""Runs the command line as `python -m panda_cosim`."""

from panda_cosim.scenarios.cli import main

main()
