"""Strategies trained in the batched world: a bank of worlds, trainers, what they keep and show."""
