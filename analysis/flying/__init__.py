"""Fly a flight with faults, in the simulator or with an autopilot, and collect its evidence.

A `WorkerPool` runs many flights at once, as jobs of processes or machines.
"""
