"""Ranges and orbits as receivers log them: RINEX, u-blox, Septentrio, alone or in flight logs."""
