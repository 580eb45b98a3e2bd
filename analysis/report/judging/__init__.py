"""What checks of a flight are made of: limits, verdicts, the autopilot's texts and reactions."""
