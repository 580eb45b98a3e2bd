"""ArduPilot in a run: how its program is started, and requests as plain MAVLink."""
