"""Evaluation of search points: by compiled flights, through the proxy, or with an autopilot."""
