"""What runs inside an FMU: FMI's calls on plain objects, in any host."""
