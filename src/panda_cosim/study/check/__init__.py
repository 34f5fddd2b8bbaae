"""Checks a scenario: prepares it as a run does, and runs our own FMUs in memory; or an FMU."""
