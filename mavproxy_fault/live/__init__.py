"""Faults while the proxy runs: requests from outside become edits of the schedule.

A *session* joins the bus and RflySim's port to the server's loop. *Control* turns requests into
edits; the *failure command* is MAV_CMD_INJECT_FAILURE. The *journal* records each edit so that a
replay repeats it. *Watching* hands chosen messages to viewers at a bounded rate.
"""
