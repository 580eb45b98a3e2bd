"""Guidance: missions, paths and the built-in controllers that fly them.

A *mission* is a path of straights and arcs by shape; a *track* gives the guidance setpoint at a
position; a *controller* turns the setpoint into actuator commands.
"""
