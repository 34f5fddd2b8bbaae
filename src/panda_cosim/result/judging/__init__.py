"""Judges a recording: signals, events, reductions, and criteria with their margins."""
