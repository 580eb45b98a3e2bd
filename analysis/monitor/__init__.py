"""The monitor: samples to results, live and offline alike.

The *pipeline* strings detection, fusion and scoring together; the *monitor* feeds it MAVLink
bytes; results are *published* on Zenoh or *watched* on a terminal.
"""
