"""MAVLink bytes: message layouts, frames, parsing, signing and telemetry logs."""
