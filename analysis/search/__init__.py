"""Random and optimised search for the worst case of an estimator."""
