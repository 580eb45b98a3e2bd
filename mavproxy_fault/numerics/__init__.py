"""Base of all three packages: compilation, rotations, the Earth, small linear algebra, constants.

It imports no other package of the project. A *compiled* function is Python code compiled by numba;
the *code cache* stores the result in a folder named by a digest of the sources.
"""
