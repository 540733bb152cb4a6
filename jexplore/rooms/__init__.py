"""Rooms in a map of free space: segmentation and scores."""
