"""One compiled step on one device or several."""

import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.normals.from_block import problem, to_block_order, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.step import trial_step
from jaxbundle.numerics.compilation import Compiled

compiled_step = Compiled(trial_step)


def step(block: Block, devices: int):
    """Reductions and unknowns of one step."""
    block = block.moved(-np.mean(block.exterior.projection_centre, 0))
    plan = plan_elimination(
        block.structure, block.groups, np.asarray(block.exterior.projection_centre), devices, "panels"
    )
    start = to_elimination_order(plan, unknowns_of(block))
    trial = compiled_step(start, problem(plan, block), jnp.array(1e-3), optimised=False)
    return trial, to_block_order(plan, trial.unknowns)
