"""What came of it: recordings and verdicts."""
