"""Sweeps: comparisons over many settings of scanner, rules, strategies and worlds, that survive whatever ends them."""
