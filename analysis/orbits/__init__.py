"""GNSS models of the analysis: broadcast orbits, atmospheric delays, snapshot solution.

Implemented independently of `simvehicle.gnss`, so that comparing the two is a meaningful test.
"""
