"""Tests and verdicts: whether there is a fault, and in which source.

The *assessment* of an epoch is every test statistic before anything is used. The *bank* holds a
leave-out test per satellite. *Hypotheses* compete: satellites, IMU, clock, several unknown.
*Ramp tests* have memory. An *exclusion* lasts until the satellite earns its *readmission*.
"""
