"""One run: settings, start values, steps, recording, summary."""
