"""The detection filter: an error-state filter that predicts each epoch before it is tested."""
