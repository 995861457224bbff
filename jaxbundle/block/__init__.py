"""The model of a block: structure and values, observations, unknowns, datum, what must hold of it."""
