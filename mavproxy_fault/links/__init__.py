"""UDP, TCP and serial links by their connection strings, and the Zenoh bus."""
