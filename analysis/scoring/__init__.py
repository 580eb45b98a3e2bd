"""How good it was: attitude errors against the truth, alarms against the labels, criteria."""
