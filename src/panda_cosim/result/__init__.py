"""What came of it, and how it looks: recordings and verdicts, pages and pictures."""
