"""The stages of an epoch: observe, predict, assess, isolate, commit, each one module.

*Observe* selects the usable measurements, *predict* propagates the filter to the epoch, *assess*
computes innovations and every test statistic, *isolate* finds which hypothesis explains a failed
test, *commit* updates filter, exclusions and bounds. `epoch_stages` runs them in this order;
`receiver_fix` does the same for a receiver's own fix, where raw ranges are missing.
"""
