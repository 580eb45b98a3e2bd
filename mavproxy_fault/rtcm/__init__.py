"""RTCM 3 on MAVLink: the pseudoranges and ephemerides that satellite faults act on.

A *transport* frame is one RTCM message with its CRC; TUNNEL messages carry it in *fragments*. An
*MSM7* message holds one epoch of one constellation, an *ephemeris message* (1019, 1046) one
satellite's broadcast orbit. `*_columns` read them by the thousand, compiled.
"""
