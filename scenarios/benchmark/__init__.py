"""What a co-simulation step costs, in ratios of one run."""
