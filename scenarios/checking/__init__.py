"""Checks a scenario without running its FMUs."""
