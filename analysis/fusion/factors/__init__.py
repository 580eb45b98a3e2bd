"""The factors of the graph: pseudoranges, IMU, other sensors, and their weights."""
