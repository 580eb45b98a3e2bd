"""Results of a campaign for people and programs: table, page, files, comparison, data set."""
