"""Scores: attitude errors against the truth, alarms against the fault labels, pass criteria."""
