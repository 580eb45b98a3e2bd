"""Plain steps: whole steps of a flight under an autopilot as one piece of machine code.

A step is *plain* where nothing but the common happens: the air of home, level ground, inertial
unit, compass, barometer and pitot tube. It gives the bytes that `Simulation.step` and
`HilPacker.frames` give, which take every other step: at a position, a heartbeat, a late reading, a
drawn block's end.
"""
