"""The page of an interactive search: one test after the other is flown and displayed.

`Flights` runs them one at a time in a thread; `flight_data` is the page's data of a flight.
"""
