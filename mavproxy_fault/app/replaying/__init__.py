"""Replays of recordings: of sessions and other logs, and of RINEX files.

*Playback* reads records in their order, *replay* passes them through the core again, and a *RINEX
replay* applies faults to the epochs of an observation file.
"""
