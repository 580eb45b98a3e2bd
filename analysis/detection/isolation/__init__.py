"""Tests and verdicts: is anything wrong, and who.

The *assessment* of an epoch is every test statistic before anything is used. The *bank* holds a
leave-out test per satellite. *Hypotheses* compete: satellites, IMU, clock, more than can be told.
*Ramp tests* have memory. An *exclusion* lasts until the satellite earns its *readmission*.
"""
