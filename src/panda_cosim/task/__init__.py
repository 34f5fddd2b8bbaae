"""What is asked: scenarios, their tables, times and routes."""
