"""Runs that last: their units, what they were asked and made from, and their results read again."""
