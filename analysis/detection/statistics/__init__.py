"""Chi-square thresholds and leave-out algebra, shared by every test of the detector.

A *statistic* is a weighted sum of squares; it exceeds its *threshold* without a fault only with the
configured false-alarm probability. The *bank* leaves measurements out of a statistic.
"""
