"""The multirotor: its equations, and the swaying flight of the worst-case search."""
