"""What `filler.py` imports."""

GOAL = 0.5  # m
