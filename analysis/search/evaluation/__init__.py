"""Evaluation of search points: by compiled kernels, in the simulator, or with an autopilot."""
