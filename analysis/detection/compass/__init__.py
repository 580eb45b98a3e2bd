"""Fault detection for compass and gyro without filter or attitude.

The compass is compared with the integrated gyro, and with the World Magnetic Model.
"""
