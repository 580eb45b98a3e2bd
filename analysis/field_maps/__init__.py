"""Which field of which message is which quantity: one table (`*.map`) per format of log.

A *field map* serves the monitor, which takes samples from it, and the report, which takes curves,
tracks, flags and states. `field_map` explains the form of the tables, `autopilot_names` has the
names of what autopilots give as numbers.
"""
