"""Commands of the actuators against what the body did: motors and surfaces that do not obey.

A *command* is what an output is driven with; an *effect* is what a command does to the body's
motion, by axis; a *deficit* is how much less than its command an actuator does, in the command's
own unit. Nothing happens here without commands, or without the vehicle's effects.
"""
