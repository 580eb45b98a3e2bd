"""What faults are made of: their contract, and what several of them share.

A *fault* is a frozen set of parameters; what moves is the state it hands back. A *value fault* is a
rule for the values of *elements* (fields, or items of array fields), which a *draft* of the frame
carries. A *target* names elements, messages, satellites or plant parameters. A *profile* is a fault
function of time, and a *series* one from a file.
"""
