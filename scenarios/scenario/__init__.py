"""A scenario's table and settings: read, checked and written."""
