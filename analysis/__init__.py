"""What the sensors said against what was true: detection, fusion, scores and reports."""
