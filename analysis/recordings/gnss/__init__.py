"""Readers of pseudoranges and ephemerides: RINEX, RTCM 3, u-blox, Septentrio, autopilot logs."""
