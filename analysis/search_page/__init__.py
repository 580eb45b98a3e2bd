"""The search on a page: one test after the other is flown and looked at.

`Flights` flies them, one at a time, while the page goes on; `flight_data` is what the page is told
of a flight.
"""
