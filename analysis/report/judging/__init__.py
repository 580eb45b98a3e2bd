"""What a flight is judged by: checks with limits, a verdict, the autopilot's reactions."""
