"""The flight that a scenario describes: truth, step by step, and what the sensors say of it.

A *kind* is a vehicle model with its controller and its parameters; other packages add theirs by
entry point. The *simulation* steps truth in its air, and the sensors *on board*; it does no I/O.
"""
