"""Log files as samples: tlog, ULog, dataflash, RINEX, u-blox and Septentrio logs, IMU CSV.

A *recording* gives samples in order of time, read from an autopilot's flight log or from files of a
GNSS receiver. A *position reference* is the true position of the antenna.
"""
