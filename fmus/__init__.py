"""The FMUs: what they are made from, how they are built, and the master that steps them."""
