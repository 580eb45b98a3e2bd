"""The scenario file: a YAML document with vehicle, mission, weather, sensors and GNSS."""
