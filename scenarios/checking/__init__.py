"""What can be told of a scenario without its FMUs, and of many random ones."""
