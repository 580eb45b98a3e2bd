"""What a ground station expects of a vehicle: parameters, missions, commands, modes, telemetry.

Each *service* is one MAVLink microservice without I/O. *Flight goals* are what PX4's automatic
modes ask of the controller; the *pilot* flies to them.
"""
