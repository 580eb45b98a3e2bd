"""Satellites, pseudoranges and a receiver.

The *constellation* says which satellites there are; *signals* are true ranges and rates with their
errors; *tracking* says which of them the receiver has; the *receiver* solves for position.
"""
