"""`adjust`: a block in, its adjustment out."""

import importlib
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.residuals import Observations, group_residuals, observations_of, ray_residuals
from jaxbundle.block.unknowns import Unknowns, angle_derivatives, unknowns_of, with_unknowns
from jaxbundle.block.validate import require_valid
from jaxbundle.geometry.precision import require_float64
from jaxbundle.normals import schur
from jaxbundle.normals.cofactors import Cofactors, cofactors
from jaxbundle.normals.plan import Plan, plan
from jaxbundle.solve import levenberg_marquardt as solver
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Iterations, Status
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, State
from jaxbundle.solve.search import DampedSearch, FullStep
from jaxbundle.solve.stopping import AbstractStoppingRule, AngleRule
from jaxbundle.solve.undetermined import undetermined_unknowns

METHODS = {"levenberg-marquardt": DampedSearch, "gauss-newton": FullStep}
ENGINES = ("block", "jaxopt")
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
    progress: Callable[[Progress], None] | None = None,
) -> Adjustment:
    """Adjusts a block by least squares; its values are the start.

    `method`: "levenberg-marquardt" or "gauss-newton". `stop`: a stopping rule, AngleRule() if none is given.
    `precision`: compute cofactors and standard deviations. `engine`: "block", or "jaxopt" as a second opinion on small
    blocks. `progress` is called after every iteration. Ctrl-C ends the iterations and keeps the last accepted unknowns.

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
    args = Arguments(observations_of(centred), plan(block.structure, block.groups), stop or AngleRule())
    if engine == "jaxopt":
        # jaxopt warns at import that it is no longer developed: only who asks for it shall load it
        second_opinion = importlib.import_module("jaxbundle.solve.second_opinion")
        unknowns, iterations = second_opinion.solve(unknowns_of(centred), args, method, max_iterations)
    else:
        unknowns, iterations = _iterate(centred, args, method, max_iterations, progress)
    return _answer(centred, unknowns, args, iterations, origin, method, precision)


def _iterate(
    block: Block,
    args: Arguments,
    method: str,
    max_iterations: int,
    progress: Callable[[Progress], None] | None,
) -> tuple[Unknowns, Iterations]:
    """Runs the solver: all steps in one program under tracing, else step by step so that a user can look on."""
    bundle = BundleSolver(METHODS[method]())
    unknowns = unknowns_of(block)
    state = start = _first(bundle, unknowns, args)
    if not block.concrete:
        unknowns, state = solver.run(bundle, unknowns, args, state, max_iterations)
        codes = jnp.array([_STATUS[k] for k in range(len(_STATUS))])
        return unknowns, _iterations(start, state, codes[state.status])
    interrupted = False
    try:
        while int(state.trials) < max_iterations and int(state.status) == solver.RUNNING:
            before = int(state.accepted)
            unknowns, state = solver.run(bundle, unknowns, args, state, 1)
            if progress is not None:
                progress(_progress(block, state, int(state.accepted) > before))
    except KeyboardInterrupt:
        interrupted = True
    status = Status.INTERRUPTED if interrupted else _STATUS[int(state.status)]
    return unknowns, _iterations(start, state, jnp.asarray(int(status)))


@eqx.filter_jit
def _first(bundle: BundleSolver, unknowns: Unknowns, args: Arguments) -> State:
    return bundle.first(unknowns, args)


def _iterations(start: State, state: State, status: Array) -> Iterations:
    return Iterations(status, state.trials, state.accepted, start.cost, state.cost, state.measure)


def _progress(block: Block, state: State, accepted: bool) -> Progress:
    cost = float(state.cost)
    sigma0 = float(np.sqrt(2 * cost / block.redundancy))
    return Progress(int(state.trials), cost, float(state.used_damping), float(state.step), accepted, sigma0)


def _answer(
    block: Block,
    unknowns: Unknowns,
    args: Arguments,
    iterations: Iterations,
    origin: Float[Array, "3"],
    method: str,
    precision: bool,
) -> Adjustment:
    """Residuals, cofactors and the adjusted block in the user's object system."""
    residuals = _residuals(unknowns, args.observations)
    weights = [args.observations.weights, *(group.weights for group in args.observations.groups)]
    computed, weak = None, ()
    if precision:
        q, computed = _cofactors(unknowns, args.observations, args.plan, block.exterior.angles.T)
        if block.concrete:
            weak = undetermined_unknowns(block, unknowns, args, q)
    return Adjustment(
        with_unknowns(block, unknowns).moved(origin),
        tuple(v.T for v in residuals),
        tuple((v * w).T for v, w in zip(residuals, weights, strict=True)),
        computed,
        iterations,
        args.rule.name,
        method,
        weak,
    )


@eqx.filter_jit
def _residuals(unknowns: Unknowns, observations: Observations) -> tuple[Array, ...]:
    """Residuals; 0 where a component is not observed."""
    groups = (jnp.where(g.weights > 0, group_residuals(unknowns, g), 0.0) for g in observations.groups)
    return ray_residuals(unknowns, observations), *groups


@eqx.filter_jit
def _cofactors(
    unknowns: Unknowns, observations: Observations, plan: Plan, reference: Float[Array, "3 image"]
) -> tuple[Cofactors, BlockCofactors]:
    """Cofactors of all unknowns, the angles turned into those of the user's rotation system (near the reference)."""
    o = observations
    q = cofactors(schur.tables(unknowns, o), plan)
    images, cameras, columns = o.exterior_free.shape[1], o.interior_free.shape[1], len(o.columns)
    of_image = 6 * jnp.arange(images)[:, None] + jnp.arange(6)
    exterior = q.kept[of_image[:, :, None], of_image[:, None, :]]
    turned = angle_derivatives(unknowns.rotation, o.in_angles, reference, o.system).transpose(2, 0, 1)
    to_user = jnp.zeros((images, 6, 6)).at[:, :3, :3].set(jnp.eye(3)).at[:, 3:, 3:].set(turned)
    exterior = to_user @ exterior @ to_user.transpose(0, 2, 1)
    of_camera = 6 * images + columns * jnp.arange(cameras)[:, None] + jnp.arange(columns)
    elements = np.array(o.columns, int)
    interior = jnp.zeros((cameras, unknowns.interior.shape[0], unknowns.interior.shape[0]))
    interior = interior.at[:, elements[:, None], elements].set(q.kept[of_camera[:, :, None], of_camera[:, None, :]])
    return q, BlockCofactors(exterior, interior, q.points.transpose(2, 0, 1))
