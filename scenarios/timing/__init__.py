"""Time-optimal timing of a table: the path of the hand, what it asks of the joints, its times."""
