"""Logs of any kind as one `FlightData`: signals, spans, events and tracks on one time axis.

`flight_sources` determines what a path holds; `from_*` convert tlogs, autopilots' logs or results.
"""
