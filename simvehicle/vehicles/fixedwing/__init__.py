"""The fixed wing: its equations, its trim, and the weaving flight of the worst-case search."""
