"""Rotations in four implementations, which a test compares.

Quaternions are (w, x, y, z), body to NED; Euler angles are roll, pitch and yaw, 3-2-1. `rotation`
is for arrays of any shape, `one_rotation` for Python floats without numpy, `rotation_kernel` for
compiled code, and `rotation_lanes` for SIMD loops, without branches.
"""
