"""The faults: one small file each, which the registry finds by the names in their classes.

A *fault* is a frozen set of parameters; what moves is the state it hands back. A *value fault*
changes *elements* (fields, or items of array fields) of a message in place; a *link fault* delays,
multiplies, damages or drops whole frames; a *satellite fault* acts on pseudoranges inside RTCM; a
*plant fault* acts in the simulator. A *profile* is a fault function of time.
"""
