"""What stands in an .fmu file: its archive, its description, its variables."""
