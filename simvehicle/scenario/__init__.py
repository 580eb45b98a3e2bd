"""The scenario file: one YAML document with vehicle, mission, weather, sensors and GNSS."""
