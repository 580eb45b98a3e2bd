"""The page for fault control and live view."""
