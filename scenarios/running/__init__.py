"""From a scenario to a run: what it starts with, its steps, its recording, its summary."""
