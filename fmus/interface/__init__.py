"""What the FMUs promise: their variables, their connections, and what a person may set."""
