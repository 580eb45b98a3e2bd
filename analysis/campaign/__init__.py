"""Campaigns: which faults, how large and when, break a subject, and did a change make it worse?

A `Cell` is a test cell: subject, scenario, fault, magnitude, onset, duration and seed. Its flight
gives `Evidence`, which is compared with that of the fault-free reference flight; the `CellResult`
has one of the ranked outcomes. A `WorkerPool` flies the jobs of a `CampaignPlan`; a `ResultsStore`
keeps every result, so an interrupted campaign continues where it stopped.
"""
