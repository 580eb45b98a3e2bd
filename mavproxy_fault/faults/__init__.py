"""The faults: one small file each, which the registry finds by the names in their classes.

A value fault changes values of a message in place; a *link fault* delays, multiplies, damages or
drops whole frames; a *satellite fault* acts on pseudoranges inside RTCM; a *plant fault* acts in
the simulator. What they are made of is in `fault_parts`.
"""
