"""Which field of which message is which quantity: one table per format of log.

A *field map* serves the monitor, which takes samples from it, and the report, which takes curves,
tracks and flags. `field_map` explains the form of the tables.
"""
