"""The compass against the gyro and against the Earth's field; neither filter nor attitude is asked.

Compass and gyro *turn apart* where the field does not turn as the rates say; the *Earth* is what
the World Magnetic Model expects at the place.
"""
