"""The building as a vehicle meets it: walls and the height of the ground."""
