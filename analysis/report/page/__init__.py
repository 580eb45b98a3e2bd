"""The report page: one HTML file with panels, tables and packed numbers, drawn by uPlot."""
