"""Beside the slave, under a name that a host may have, too."""


def double(x):
    """Twice."""
    return 2 * x
