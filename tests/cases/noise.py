"""New errors for the observations of a simulated block."""

import equinox as eqx
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.planning.simulation import Simulation


def with_noise(simulation: Simulation, seed: int) -> Block:
    """The block with other normal errors of its rays and of what else is observed; its start stays."""
    rng, truth = np.random.default_rng(seed), simulation.truth

    def measured(values, sigmas):
        return values + sigmas * rng.standard_normal(values.shape)

    groups = tuple(eqx.tree_at(lambda g: g.values, g, measured(g.values, g.sigmas)) for g in truth.groups)
    rays = measured(truth.rays.coordinates, truth.rays.sigmas)
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), simulation.block, (rays, groups))
