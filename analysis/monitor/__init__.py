"""The monitor: samples to results, live and offline alike.

The *pipeline* runs the navigation filter, the other detectors and the attitude scores; the
*monitor* feeds it MAVLink bytes; results are published on Zenoh or shown on a terminal.
"""
