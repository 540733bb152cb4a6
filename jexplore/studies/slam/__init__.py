"""Localisation and mapping of recorded logs."""
