"""Reports as one HTML file: panels, tables and packed numbers, drawn by uPlot in the browser."""
