"""Sensors other than pseudoranges and IMU, tested against the navigation filter or each other.

Here too are those that leave their own *level*, and signals that are jammed; what is about heading
is in `compass`, whether samples come at all in `streams`.
"""
