"""The simulation of a scenario: truth step by step, and the readings of the sensors.

A *kind* is a vehicle model with its controller and its parameters; other packages add theirs by
entry point. The *simulation* steps vehicle, weather and *onboard sensors*; it does no I/O.
"""
