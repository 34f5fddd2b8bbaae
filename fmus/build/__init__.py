"""From sources to .fmu and .ssp files."""
