"""Satellites as the analysis sees them: broadcast orbits, atmosphere, the snapshot solution.

Written independently of `simvehicle.gnss`, so that a test between the two means something.
"""
