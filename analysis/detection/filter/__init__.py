"""The detection filter: an error-state Kalman filter that predicts each epoch before its tests."""
