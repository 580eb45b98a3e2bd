"""What ArduPilot is fed in bytes: VectorNav packets, a line of physics, its own MAVLink; no I/O."""
