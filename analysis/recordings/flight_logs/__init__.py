"""What autopilots log: PX4's ULog and ArduPilot's dataflash.

A *topic* is the columns of one message; a log's *condition* is what of it is damaged or was lost.
"""
