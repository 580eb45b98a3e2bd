"""Which field of which message is which curve, a table per kind of log, and what follows from it.

A *curve* takes the columns of one message to the values of one `Signal`; a *spectrum* is what a
signal holds by frequency.
"""
