"""The simulator as a process: the `sim` subcommand, its loops, its pace and its pictures.

The *lockstep loop* flies the simulation under an autopilot on the HIL link; the *server* flies it
in real time or faster.
"""
