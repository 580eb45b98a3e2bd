"""The sensors, one file each: truth in, readings out.

A *sensor* is a frozen set of parameters with a rate; its state is handed back. A *reading* is what
it says, in SI units and stamped. The *error model* (white noise, bias, drift, random walk, scale)
is shared by all.
"""
