"""The environment of a vehicle: air and wind, terrain and gravity."""
