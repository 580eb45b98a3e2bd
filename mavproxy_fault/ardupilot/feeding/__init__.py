"""Encoders of ArduPilot's inputs: VectorNav packets, JSON physics, MAVLink messages; no I/O."""
