"""Regression tests: runs compared with references, and the report of what differs."""
