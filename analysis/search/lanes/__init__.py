"""The flight of many variations at once, as kernels over lanes of a vector register.

A *lane* is one variation. These kernels are the vectorised twin of the simulator's step; a test
holds both to the same numbers.
"""
