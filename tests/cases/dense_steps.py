"""One step of the solver at several dampings, against the dense equations."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from cases.dense_adjustment import centred, dense_step, dense_system, difference, sizes

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.normals.from_block import problem, to_block_order, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import plan_elimination
from jaxbundle.normals.plan.reduced_plan import Method
from jaxbundle.solve.damping import Undamped
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, run
from jaxbundle.solve.stopping_rules import AngleRule

DAMPINGS = (1e-12, 1e-8, 1e-4, 1e-2, 1.0, 1e3, 1e6)


def block_steps(block: Block, dampings: tuple[float, ...], reduced: Method, devices: int) -> list[Unknowns]:
    """The unknowns after one step of the solver at each damping; the only place that knows how a step is made."""
    centres = np.asarray(block.exterior.projection_centre)
    arrangement = plan_elimination(block.structure, block.groups, centres, devices, reduced)
    block = block.moved(-jnp.mean(block.exterior.projection_centre, 0))
    start, args = (
        to_elimination_order(arrangement, unknowns_of(block)),
        Arguments(problem(arrangement, block), AngleRule()),
    )
    solver = BundleSolver(Undamped())  # which takes whatever step it is given
    stepped = []
    for damping in dampings:
        state = eqx.tree_at(lambda s: s.damping.factor, solver.first(), jnp.array(damping, float))
        stepped.append(to_block_order(arrangement, run(solver, start, args, state, 1, optimised=False).unknowns))
    return stepped


def assert_dense_steps(block: Block, reduced: Method, devices: int = 1) -> None:
    """From approximate values far off, at dampings from none to a gradient step."""
    unknowns, observations = centred(block)
    system = dense_system(unknowns, observations)
    assert len(system.lengths) == block.structure.n_unknowns
    # the last digit of values of some kilometres is felt by steps of a hundredth of a millimetre
    rounding = np.finfo(float).eps * np.linalg.norm(system.lengths * sizes(unknowns, observations))
    for damping, stepped in zip(DAMPINGS, block_steps(block, DAMPINGS, reduced, devices), strict=True):
        expected = dense_step(system, damping)
        off = difference(unknowns, stepped, observations) - expected
        allowed = 1e-10 * np.linalg.norm(system.lengths * expected) + rounding
        assert np.linalg.norm(system.lengths * off) < allowed, damping
