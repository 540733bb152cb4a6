"""Robots that do not know where they are: true and estimated pose, motion with errors, scans from the true pose."""
