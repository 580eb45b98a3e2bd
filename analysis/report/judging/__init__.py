"""Assessment of a flight: checks with limits, the verdict, the autopilot's reactions to faults."""
