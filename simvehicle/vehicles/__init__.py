"""The kinds of vehicle and their parameter files."""
