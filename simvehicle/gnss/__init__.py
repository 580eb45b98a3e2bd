"""Satellites, pseudoranges and a receiver.

The *constellation* holds the satellites and their ephemerides; *signals* are true ranges and rates
with errors; *tracking* determines which of them the receiver has; the *receiver* computes a fix.
"""
