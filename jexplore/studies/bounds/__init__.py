"""Length of the shortest walk on which a robot that knows the map sees everything."""
