"""MAVLink bytes: layouts, frames, parsing, signing, RTCM payloads and telemetry logs."""
