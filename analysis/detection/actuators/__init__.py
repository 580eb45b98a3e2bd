"""Fault detection for actuators: compares their commands with the vehicle's motion.

A *command* is the value an output is driven with. An *effect* is the change of the body's motion,
per axis, that a command causes. A *deficit* is how much less than its command an actuator does, in
units of the command. Without commands or effects nothing is tested.
"""
