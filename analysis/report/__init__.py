"""Reports from logs and results."""
