"""Sweeps: many runs of a scenario with varied values, their table, its report, and a search."""
