"""ArduPilot in a run: its process, and commands as plain MAVLink."""
