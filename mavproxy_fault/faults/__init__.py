"""The faults: one small file each, listed in `registry`."""
