"""Whether samples come as they should: silence, repetition, rate, stamps; values are not judged.

A *stream* is one kind of sample, of the IMU one instance; in a *pause* nobody comes.
"""
