"""From .fmu and .ssp files to rows: read, checked, coupled and stepped."""
