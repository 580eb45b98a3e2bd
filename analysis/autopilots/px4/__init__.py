"""PX4 in a run: its process, its parameters, and commands by MAVSDK."""
