"""Readers of autopilot logs: PX4's ULog and ArduPilot's dataflash.

A *topic* holds the columns of one message; a log's *condition* is what is corrupted or missing.
"""
