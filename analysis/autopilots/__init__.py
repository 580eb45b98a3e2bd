"""Scenarios flown by an unmodified autopilot, monitored and recorded like any other run.

A **running autopilot** is the autopilot's process with its links. The **operator** flies it from
the ground with MAVLink **commands**, the same for both but for their modes.
"""
