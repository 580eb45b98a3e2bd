"""Files of others as samples: RINEX observations and navigation, ULog, dataflash, an IMU's CSV.

A *recording* hands out samples in the order of their stamps, whatever files it was made of.
"""
