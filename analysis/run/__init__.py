"""A whole fault test in one process: simulator, proxy, monitor and report."""
