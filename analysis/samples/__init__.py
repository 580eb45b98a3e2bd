"""Sensor samples, the common input of all detectors and estimators.

A *sample* is one sensor reading with its timestamp; an *epoch* holds the pseudoranges of one
receiver epoch. A *block* is a table of consecutive samples. The *decoder* converts MAVLink frames
to blocks.
"""
