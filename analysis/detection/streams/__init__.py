"""Fault detection on the arrival of samples: silence, repetition, rate and timestamps.

A *stream* is the samples of one kind, and of one instance for an IMU; in a *pause* no stream has
samples. Values are not tested, except for their repetition.
"""
