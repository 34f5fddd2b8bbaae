"""The FMUs: slaves, packaging, and the master that steps them."""
