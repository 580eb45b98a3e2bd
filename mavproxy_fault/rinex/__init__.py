"""RINEX files: their text, and faults on their observations.

A *range epoch* passes through the fault engine like a message; the changes are then written back
to its lines.
"""
