"""How rooms are found in a map of free space, and scored."""
