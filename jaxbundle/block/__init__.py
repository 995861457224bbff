"""The model of a block: structure and values, observations, unknowns, datum, and its validation."""
