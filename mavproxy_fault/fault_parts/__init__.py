"""Building blocks of faults: their contract and shared parts.

A *fault* is a frozen set of parameters; its state is passed in and returned. A *value fault* is a
rule for the values of *elements* (fields, or items of array fields), applied to a *draft* of the
frame. A *target* names elements, messages, satellites or plant parameters. A *profile* is a fault
as a function of time, and a *series* one that is read from a file.
"""
