"""The multirotor: its equations, and a flight of the search that *sways*."""
