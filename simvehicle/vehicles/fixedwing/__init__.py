"""The fixed wing: its equations, its trim, and a flight of the search that *weaves*."""
