"""What a search varies: a test file with its dimensions, and a point of it as a scenario."""
