"""Whole episodes in native code: the rules of `exploration/`, for a CPU core or a warp of a GPU.

JAX is the reference; tests hold this code to its numbers, bit by bit.
"""
