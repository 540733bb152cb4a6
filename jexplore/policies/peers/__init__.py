"""Strategies of other groups, in two dimensions, each as in its paper but for what its docstring says."""
