"""Plain steps: complete steps of a flight under an autopilot in one compiled function.

A step is *plain* if only common sensors take part: IMU, compass, barometer and pitot tube, above
level ground, in the air of the home position. It gives the same bytes as `Simulation.step` and
`HilPacker.frames`, which process all other steps: those with a GPS position, a heartbeat or a late
reading, and the last of a block of random draws.
"""
