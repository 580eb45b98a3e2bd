"""RTCM 3 on MAVLink: the pseudoranges and ephemerides that satellite faults act on.

A *transport* frame is one RTCM message with its CRC; TUNNEL messages carry it in *fragments*. An
*MSM7* message contains one epoch of one constellation, an *ephemeris message* (1019, 1046) the
broadcast orbit of one satellite.
"""
