"""Files of others as samples: RINEX, u-blox logs, ULog, dataflash, an IMU's CSV.

A *recording* hands out samples in the order of their stamps, whatever files it was made of: of the
flight logs of autopilots, of GNSS receivers' files. A *reference* is where the antenna really was.
"""
