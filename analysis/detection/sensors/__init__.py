"""Fault detection for sensors other than pseudoranges and IMU, with the filter or with each other.

It also has the detectors of a changed *level* and of jammed signals. Detectors about heading are in
`compass`, those about the arrival of samples in `streams`.
"""
