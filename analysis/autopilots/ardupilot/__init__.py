"""ArduPilot in a run: its process."""
