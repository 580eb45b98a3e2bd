"""Logs of any kind as one `Recording`: signals, spans, events and tracks on one time axis.

`sources` finds what a path holds; `from_*` reads tlog, ULog, dataflash log or a run's results.
"""
