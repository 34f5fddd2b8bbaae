"""Analyses the control loops of any scenario: pulses, the coupled FMUs' responses, margins."""
