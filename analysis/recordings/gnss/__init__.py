"""Readers of GNSS pseudoranges and ephemerides: RINEX, u-blox, Septentrio, autopilot logs."""
