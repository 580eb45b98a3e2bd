"""Live control: requests that set, change or clear faults while the proxy runs.

A *session* connects Zenoh and RflySim's UDP port to the server's loop. `LiveControl` turns requests
into edits of the schedule; the *failure command* is MAV_CMD_INJECT_FAILURE. The *edit log* records
each edit, so that a replay repeats it. *Subscriptions* give viewers samples of chosen messages.
"""
