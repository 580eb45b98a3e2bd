"""Scenarios flown by a real autopilot, watched and recorded as any other run.

A **program** is the autopilot in flight: its process and the links it is heard on. The **operator**
flies it from the ground by **requests**, in the words that the autopilot knows: MAVLink for
ArduPilot, MAVSDK for PX4.
"""
