"""A scenario and the flight it describes.

The *scenario file* is one YAML document: vehicle, mission, weather, sensors, GNSS, schedule. A
*kind* is a vehicle model with its controller and its parameters. The *simulation* steps truth and
the sensors *on board*, without I/O.
"""
