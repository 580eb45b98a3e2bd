"""Attitude estimators under test, one file each."""
