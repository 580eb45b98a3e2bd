"""Rotations, in four forms of one rule that a test holds together.

Quaternions are (w, x, y, z), body to NED; Euler angles are roll, pitch and yaw, 3-2-1. `rotation`
takes arrays of any number. `one_rotation` takes plain floats, and needs no numpy. `rotation_kernel`
is compiled, for one at a time. `rotation_lanes` has no branches, so that loops become SIMD code.
"""
