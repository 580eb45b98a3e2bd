"""The sensors, one file each: truth in, readings out.

A *sensor* is a frozen set of parameters with a rate; its state is passed in and returned. A
*reading* is its output, in SI units and with a timestamp. All share the *error model*: white noise,
bias, drift, random walk and scale.
"""
