"""Satellites, pseudoranges and a receiver."""
