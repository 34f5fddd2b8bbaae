"""What a scenario is: its table and settings, read and checked."""
