"""Named faults of the field as YAML files."""
