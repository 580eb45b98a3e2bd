"""Tests of a receiver's own position and velocity with the filter, without raw ranges."""
