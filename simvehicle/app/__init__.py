"""The simulator as a process: the `sim` subcommand, its loops and its pace.

The *lockstep loop* runs the simulation with an autopilot on the HIL link; the *server* runs it in
real time or faster with the built-in controller.
"""
