"""A receiver's own position and velocity against the filter, where raw ranges are missing."""
