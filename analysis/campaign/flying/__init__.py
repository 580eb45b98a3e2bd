"""Fly the cells of a campaign: in the simulator, in compiled lanes, or with an autopilot.

A `FlightJob` is one flight for all its subjects, a `LaneJob` a batch of compiled flights; both can
run in another process or on another machine, and return a `JobAnswer`.
"""
