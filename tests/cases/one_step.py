"""One compiled step on one device or several."""

import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.arrange import arrange, arranged_unknowns, problem, restored_unknowns
from jaxbundle.normals.step import trial_step
from jaxbundle.numerics.compilation import Compiled

compiled_step = Compiled(trial_step)


def step(block: Block, devices: int):
    """Reductions and unknowns of one step."""
    block = block.moved(-np.mean(block.exterior.projection_centre, 0))
    plan = arrange(block.structure, block.groups, np.asarray(block.exterior.projection_centre), devices, "panels")
    start = arranged_unknowns(plan, unknowns_of(block))
    trial = compiled_step(start, problem(plan, block), jnp.array(1e-3), optimised=False)
    return trial, restored_unknowns(plan, trial.unknowns)
