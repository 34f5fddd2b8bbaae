"""The Python code that runs inside FMUs: it translates FMI's calls to plain objects."""
