"""Sensor data compared with the truth: fault detection, fusion, scores and reports."""
