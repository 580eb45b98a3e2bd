"""Fly the cells of a campaign: through the proxy, by compiled flights, or with an autopilot.

A `FlightJob` is one flight for all its subjects, or a batch of compiled flights; it can run in
another process or on another machine, and returns a `JobAnswer`.
"""
