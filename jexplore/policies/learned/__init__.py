"""Strategies whose weights were learned: features of frontier clusters, networks that score them, files of weights."""
