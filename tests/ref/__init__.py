"""Slow plain-numpy oracles, written from the definitions and not from the kernels that they check."""
