"""A MAVLink proxy that applies scripted and live faults and writes down what it did.

Bytes come in, become frames, pass the faults that are active, and leave as bytes.
"""

__version__ = "0.1.0"
