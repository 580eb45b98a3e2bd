"""The search space: a test file, its dimensions, and a point of it as a scenario."""
