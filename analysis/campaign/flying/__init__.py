"""How a cell's question is put: in the simulator, in compiled lanes, or to an autopilot.

A `FlightJob` is one flight for all its subjects, a `LaneJob` a batch of compiled ones; both can be
sent to another process or machine and give back an `Answer`.
"""
