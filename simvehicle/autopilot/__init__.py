"""The MAVLink services of an autopilot: parameters, missions, commands, modes, telemetry.

Each *service* is one MAVLink microservice without I/O. PX4's automatic modes set *flight goals*;
the *pilot* makes the built-in controller fly to them.
"""
