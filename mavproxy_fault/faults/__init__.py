"""The faults: small files, in which the registry finds every class with a `name`.

A *value fault* changes values of a message in place; a *link fault* delays, duplicates, corrupts or
drops frames; a *satellite fault* acts on pseudoranges in RTCM; a *plant fault* acts in the
simulator. Their building blocks are in `fault_parts`.
"""
