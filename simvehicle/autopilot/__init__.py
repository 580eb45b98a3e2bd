"""What a ground station expects of a vehicle: parameters, missions, commands and streams."""
