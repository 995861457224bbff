"""`adjust`: a block in, its adjustment out."""

import importlib
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block, ExteriorOrientation
from jaxbundle.block.datum import with_datum
from jaxbundle.block.residuals import Observations, group_residuals, observations_of, ray_residuals
from jaxbundle.block.unknowns import (
    Unknowns,
    angle_derivatives,
    corrected_in_angles,
    unknowns_of,
    with_unknowns,
)
from jaxbundle.block.validate import require_valid
from jaxbundle.normals.arrange import (
    Arranged,
    Arrangement,
    Problem,
    arrange,
    arranged_unknowns,
    problem,
    restored_unknowns,
)
from jaxbundle.normals.cofactors import Cofactors, cofactors
from jaxbundle.normals.reduced_plan import Method
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION, Compiled
from jaxbundle.numerics.precision import require_float64
from jaxbundle.solve import levenberg_marquardt as solver
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Iterations, Status
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, State
from jaxbundle.solve.search import DampedSearch, FullStep
from jaxbundle.solve.stopping import AbstractStoppingRule, AngleRule
from jaxbundle.solve.undetermined import undetermined_unknowns

METHODS = {"levenberg-marquardt": DampedSearch, "gauss-newton": FullStep}
ENGINES = ("block", "jaxopt")
RAYS_FOR_DEVICES = 10_000
_STATUS = {
    solver.RUNNING: Status.MAXIMUM_ITERATIONS,
    solver.CONVERGED: Status.CONVERGED,
    solver.SINGULAR: Status.SINGULAR,
    solver.DIVERGED: Status.DIVERGED,
    solver.STALLED: Status.STALLED,
}


class Progress(NamedTuple):
    """One iteration as a progress callback sees it; `step` is |J d| / |v|."""

    iteration: int
    cost: float
    damping: float
    step: float
    accepted: bool
    sigma0: float


def adjust(
    block: Block,
    *,
    method: str = "levenberg-marquardt",
    stop: AbstractStoppingRule | None = None,
    max_iterations: int = 200,
    precision: bool = True,
    engine: str = "block",
    reduced: Method = "auto",
    devices: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Adjustment:
    """Adjusts a block by least squares; its values are the start.

    `method`: "levenberg-marquardt" or "gauss-newton". `stop`: a stopping rule, AngleRule() if none is given.
    `precision`: compute cofactors and standard deviations. `engine`: "block", or "jaxopt" as a second opinion on small
    blocks. `reduced`: how the reduced equations are solved, "dense" or "panels", "auto" by their size. `devices`: JAX
    devices to deal the points to; if None all of them, or one for a small block. `progress` is called after every
    iteration. Ctrl-C ends the iterations and keeps the last accepted unknowns.

    Raises: BlockError with all problems of the block; ValueError for an unknown name or without float64.
    """
    require_float64()
    if method not in METHODS or engine not in ENGINES:
        raise ValueError(f"no method {method!r} with engine {engine!r}; there are {list(METHODS)} and {list(ENGINES)}")
    if block.concrete:
        require_valid(block)
    block = with_datum(block)
    origin = jax.lax.stop_gradient(jnp.mean(block.exterior.projection_centre, 0))
    centred = block.moved(-origin)
    rule = stop or AngleRule()
    centres = np.asarray(block.exterior.projection_centre) if block.concrete else None
    plan = arrange(block.structure, block.groups, centres, devices or _useful_devices(block), reduced)
    if engine == "jaxopt":
        # jaxopt warns at import that it is no longer developed: only who asks for it shall load it
        second_opinion = importlib.import_module("jaxbundle.solve.second_opinion")
        args = second_opinion.Arguments(observations_of(centred), rule)
        unknowns, iterations = second_opinion.solve(unknowns_of(centred), args, method, max_iterations)
        arranged = arranged_unknowns(plan, unknowns)
    else:
        arguments = Arguments(problem(plan, centred), rule.arranged(plan.order))
        arranged, iterations = _iterate(centred, plan, arguments, method, max_iterations, progress)
    return _answer(block, centred, plan, arranged, iterations, origin, rule.name, method, precision)


def _useful_devices(block: Block) -> int:
    """Devices worth dealing the tiles to: a small block loses more to their exchange than it gains."""
    return jax.local_device_count() if len(block.structure.ray_image) >= RAYS_FOR_DEVICES else 1


def _is_large(block: Block) -> bool:
    return len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION


def _iterate(
    block: Block,
    plan: Arrangement,
    args: Arguments,
    method: str,
    max_iterations: int,
    progress: Callable[[Progress], None] | None,
) -> tuple[Arranged, Iterations]:
    """Runs the solver: all steps in one program under tracing, else step by step so that a user can look on."""
    bundle = BundleSolver(METHODS[method]())
    unknowns, state = arranged_unknowns(plan, unknowns_of(block)), bundle.first()
    optimised = _is_large(block)
    if not block.concrete:
        unknowns, state = solver.run(bundle, unknowns, args, state, max_iterations, optimised=optimised)
        codes = jnp.array([_STATUS[k] for k in range(len(_STATUS))])
        return unknowns, _iterations(state, codes[state.status])
    interrupted = False
    try:
        while int(state.trials) < max_iterations and int(state.status) == solver.RUNNING:
            before = int(state.accepted)
            unknowns, state = solver.run(bundle, unknowns, args, state, 1, optimised=optimised)
            if progress is not None:
                progress(_progress(block, state, int(state.accepted) > before))
    except KeyboardInterrupt:
        interrupted = True
    status = Status.INTERRUPTED if interrupted else _STATUS[int(state.status)]
    return unknowns, _iterations(state, jnp.asarray(int(status)))


def _iterations(state: State, status: Array) -> Iterations:
    return Iterations(status, state.trials, state.accepted, state.initial_cost, state.cost, state.measure)


def _progress(block: Block, state: State, accepted: bool) -> Progress:
    cost = float(state.cost)
    sigma0 = float(np.sqrt(2 * cost / block.redundancy))
    return Progress(int(state.trials), cost, float(state.used_damping), float(state.step), accepted, sigma0)


def _in_user_system(block: Block, adjusted: Block) -> Block:
    """The adjusted block with what was given exactly as it was given: the shift of the origin rounds."""
    points = jnp.where(jnp.asarray(block.structure.point_free), adjusted.object_points, block.object_points)
    free = jnp.asarray(block.structure.exterior_free)
    centre = jnp.where(free[:, :3], adjusted.exterior.projection_centre, block.exterior.projection_centre)
    angles = jnp.where(free[:, 3:], adjusted.exterior.angles, block.exterior.angles)
    return eqx.tree_at(
        lambda b: (b.object_points, b.exterior, b.interior),
        block,
        (points, ExteriorOrientation(centre, angles), adjusted.interior),
    )


def _answer(
    user: Block,
    block: Block,
    plan: Arrangement,
    arranged: Arranged,
    iterations: Iterations,
    origin: Float[Array, "3"],
    rule: str,
    method: str,
    precision: bool,
) -> Adjustment:
    """Residuals, cofactors and the adjusted block in the user's object system."""
    unknowns, observations = restored_unknowns(plan, arranged), observations_of(block)
    residuals = _residuals(unknowns, observations, optimised=_is_large(block))
    weights = [observations.weights, *(group.weights for group in observations.groups)]
    computed, weak = None, ()
    if precision:
        q = _cofactors(arranged, problem(plan, block), optimised=_is_large(block))
        computed = _block_cofactors(block, plan, unknowns, q)
        if block.concrete:
            weak = undetermined_unknowns(block.structure, plan, q)
    return Adjustment(
        _in_user_system(user, with_unknowns(block, unknowns).moved(origin)),
        tuple(v.T for v in residuals),
        tuple((v * w).T for v, w in zip(residuals, weights, strict=True)),
        computed,
        iterations,
        rule,
        method,
        weak,
    )


@Compiled
def _cofactors(arranged: Arranged, problem: Problem) -> Cofactors:
    return cofactors(arranged, problem)


@Compiled
def _residuals(unknowns: Unknowns, observations: Observations) -> tuple[Array, ...]:
    """Residuals; 0 where a component is not observed."""
    groups = (jnp.where(g.weights > 0, group_residuals(unknowns, g), 0.0) for g in observations.groups)
    return ray_residuals(unknowns, observations), *groups


def _block_cofactors(block: Block, plan: Arrangement, unknowns: Unknowns, q: Cofactors) -> BlockCofactors:
    """Cofactors in the order of the block, the angles turned into those of the user's rotation system."""
    structure, shape = block.structure, plan.shape
    rows = q.images[plan.order.image]
    partly = corrected_in_angles(structure)
    in_angles = None if partly is None else jnp.asarray(partly)
    reference, system = block.exterior.angles.T, structure.rotation_system
    turned = angle_derivatives(unknowns.rotation, in_angles, reference, system).transpose(2, 0, 1)
    to_user = jnp.zeros((len(rows), 6, 6)).at[:, :3, :3].set(jnp.eye(3)).at[:, 3:, 3:].set(turned)
    exterior = to_user @ rows[:, :6, :6] @ to_user.transpose(0, 2, 1)

    elements, columns = block.interior.elements.shape[1], np.array(structure.interior_columns, int)
    cameras, count = len(structure.cameras), len(columns)
    if shape.image > 6:
        own = q.images[plan.order.camera][:, 6:, 6:]
    else:
        at = count * np.arange(cameras)[:, None] + np.arange(count)
        own = q.border[at[:, :, None], at[:, None, :]]
    interior = jnp.zeros((cameras, elements, elements)).at[:, columns[:, None], columns].set(own)

    at = shape.shared * shape.cameras + 3 * np.arange(shape.kept)[:, None] + np.arange(3)
    kept = q.border[at[:, :, None], at[:, None, :]]
    points = jnp.concatenate([q.points.transpose(2, 3, 0, 1).reshape(-1, 3, 3), kept])[plan.order.point]
    return BlockCofactors(exterior, interior, points)
