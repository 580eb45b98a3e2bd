"""The data of a flight as signals, and the curves of a report that are made of them.

`recording` defines `FlightData`, which all readers of logs fill; `panels` lists the plots. For each
kind of log a table says which field of which message gives which curve.

A *log curve* converts the columns of one message to the values of one `Signal`; *derived* curves
are computed from others. A *spectrum* is the power spectral density of a signal.
"""
