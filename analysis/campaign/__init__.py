"""Campaigns: which faults, how large and when, break a subject, and did a change make it worse?

A `Cell` is one question: a subject, a scenario, a fault with its magnitude, onset and duration, and
a seed. A flight answers it with `Evidence`, which is held against that of the *twin*, the same
flight without the fault; what comes of it is a `CellResult` with one of the ranked outcomes.
A `Fleet` flies what the plan asks for; the ledger keeps what is answered, so that a campaign goes
on after a kill.
"""
