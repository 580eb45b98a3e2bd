"""Files of others as samples: RINEX, u-blox logs, ULog, dataflash, an IMU's CSV.

A *recording* hands out samples in the order of their stamps, whatever files it was made of.
"""
