"""Runs the command line as `python -m scenarios.cli`."""

from scenarios.cli import main

main()
