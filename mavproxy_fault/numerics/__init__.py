"""Base of all three packages: compilation, rotations, the Earth, small linear algebra, constants.

It imports nothing else of ours. A *compiled* function is Python that numba turns into machine
code; the *code cache* keeps it in a folder named after the sources it was made of.
"""
