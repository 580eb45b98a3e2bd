"""How a point of the search is flown: in lanes, in the simulator, or under an autopilot."""
