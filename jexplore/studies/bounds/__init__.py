"""How long the shortest walk is on which a robot that knew the map would have seen everything."""
