"""The world a vehicle flies in: air and wind, terrain, gravity and the magnetic field."""
