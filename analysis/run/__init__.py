"""A complete fault test in one command: simulator, proxy, monitor and report."""
