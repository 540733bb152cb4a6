"""Teams: several robots explore one world on a common clock, as a program of the engine."""
