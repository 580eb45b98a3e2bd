"""Curves of a report: which field of which message gives which curve, one table per kind of log.

A *log curve* converts the columns of one message to the values of one `Signal`; *derived* curves
are computed from others. A *spectrum* is the power spectral density of a signal.
"""
