"""The environment of a vehicle: air and wind, terrain, gravity and the magnetic field."""
