"""Inner loops for processors: compiled by numba, called by XLA programs.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers, which takes half of the time and, of few
particles, a third. Where numba is not installed (extra ``fast``), on accelerators, in
32 bits and under a derivative the same is computed by XLA; a test holds both equal.
"""
