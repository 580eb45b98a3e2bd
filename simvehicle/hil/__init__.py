"""Hardware in the loop as PX4 speaks it: HIL frames out, actuator commands in, in lockstep.

*HIL frames* are readings and truth as MAVLink messages. *Lockstep* says when the next step may be
taken; its *loop* flies the simulation under an autopilot. The *inbox* gathers what a link brings;
*plant changes* are faults of the vehicle itself that come over it.
"""
