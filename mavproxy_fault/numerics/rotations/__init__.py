"""Rotations in three implementations, which a test compares.

Quaternions are (w, x, y, z), body to NED; Euler angles are roll, pitch and yaw, 3-2-1. `rotation`
is for arrays of any shape, `one_rotation` for Python floats without numpy, and `rotation_kernel`
for compiled code.
"""
