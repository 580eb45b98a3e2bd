"""Fly one flight with faults, in the simulator or with an autopilot, and collect its evidence."""
