"""Measures the cost of a co-simulation step."""
