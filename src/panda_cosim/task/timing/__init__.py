"""Time-optimal timing of a table: the hand's path, its demands on the joints, its times."""
