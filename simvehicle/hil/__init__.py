"""PX4's hardware-in-the-loop protocol: HIL frames out, actuator commands in, in lockstep.

*HIL frames* are readings and truth as MAVLink messages. *Lockstep* decides when the next step may
be taken. *Plant changes* are plant faults that arrive on a link.
"""
