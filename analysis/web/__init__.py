"""The web page for fault control and live view."""
