"""What a campaign found, for people and for programs: table, page, files, comparison, data set."""
