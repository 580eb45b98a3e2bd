"""Sensors other than pseudoranges and IMU, tested against the navigation filter."""
