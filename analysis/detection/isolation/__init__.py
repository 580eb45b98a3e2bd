"""Tests of an epoch and verdicts: whether there is a fault, and which hypothesis explains it.

*Statistics* are computed before any measurement is used. *Hypotheses* compete: satellites, IMU,
clock, an entire system, unknown. *Ramp tests* have memory. An *exclusion* lasts until the satellite
earns its *readmission*; `Trust` holds what is believed from epoch to epoch.
"""
