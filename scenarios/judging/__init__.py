"""From a recording to a verdict: signals, events, reductions and criteria with their margins."""
