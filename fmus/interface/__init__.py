"""Interfaces of the FMUs: variables, connections, and parameters that users set."""
