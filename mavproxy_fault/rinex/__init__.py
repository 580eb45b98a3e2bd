"""RINEX files: their text, and observations with faults in them.

An *epoch of ranges* passes through the fault engine as a message does; what the faults made of it
is written back into the lines it came from.
"""
