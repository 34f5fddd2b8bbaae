"""Runs a scenario: start values, steps, recording, summary."""
