"""PX4 in a run: its process and its parameters."""
