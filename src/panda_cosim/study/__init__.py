"""Many runs, or one closely: checks, comparisons, sweeps, analyses, live."""
