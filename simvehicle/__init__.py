"""A vehicle simulator: truth, sensors and the MAVLink frames that carry them."""
