"""`adjust`: a block in, its adjustment out."""

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import sequential_vmap
from jaxtyping import Array

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.residuals import observations_of
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.block.validate import require_valid
from jaxbundle.normals.arrange import Arranged, Arrangement, arrange, arranged_unknowns, problem, restored_unknowns
from jaxbundle.normals.reduced_plan import Method
from jaxbundle.normals.step import placed
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION
from jaxbundle.numerics.host import on_device, on_host
from jaxbundle.numerics.precision import require_float64
from jaxbundle.solve import levenberg_marquardt as solver
from jaxbundle.solve.adjustment import Adjustment, Iterations, Status
from jaxbundle.solve.answer import adjustment
from jaxbundle.solve.checkpoint import Keeper, fingerprint
from jaxbundle.solve.free_network import constrained, freed
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, State
from jaxbundle.solve.robust import AbstractWeightFunction, Solve, adjust_robustly
from jaxbundle.solve.search import DampedSearch, FullStep
from jaxbundle.solve.stopping import AbstractStoppingRule, AngleRule

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
    checkpoint: Path | None = None,
    robust: AbstractWeightFunction | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Adjustment:
    """Adjusts a block by least squares; its values are the start.

    `method`: "levenberg-marquardt" or "gauss-newton". `stop`: a stopping rule, AngleRule() if none is given.
    `precision`: compute cofactors and standard deviations. `engine`: "block", or "jaxopt" as a second opinion on small
    blocks. `reduced`: how the reduced equations are solved, "dense", "panels" or "pcg" (conjugate gradients, which give
    no standard deviations), "auto" by their size. `devices`: JAX devices to deal the points to; if None all of them, or
    one for a small block. `checkpoint`: a file that keeps the state after every accepted iteration; where it exists the
    solve goes on from it. `robust`: a weight function for gross errors in the rays, as Huber(); its weights are kept in
    `reweighting`. `progress` is called after every iteration. Ctrl-C ends the iterations and keeps the last
    accepted unknowns.

    Raises: BlockError with all problems of the block; CheckpointError for a checkpoint of another block; ValueError for
    an unknown name or without float64.
    """
    require_options(method, engine, precision, reduced)
    if block.concrete:
        require_valid(block)
    wanted = _Wanted(method, stop or AngleRule(), max_iterations, engine, reduced, devices, progress)
    if robust is None:
        return _least_squares(block, wanted, precision, checkpoint)
    if checkpoint is not None:
        raise ValueError("a robust adjustment solves many times and keeps no checkpoint")
    solve = Solve(
        lambda b: _least_squares(b, wanted, False, None), lambda b: _least_squares(b, wanted, precision, None)
    )
    return adjust_robustly(block, robust, solve)


def require_options(method: str, engine: str, precision: bool, reduced: Method) -> None:
    """Raises ValueError for options that no block can be adjusted with."""
    require_float64()
    if method not in METHODS or engine not in ENGINES:
        raise ValueError(f"no method {method!r} with engine {engine!r}; there are {list(METHODS)} and {list(ENGINES)}")
    if precision and reduced == "pcg":
        raise ValueError("conjugate gradients give no standard deviations: call adjust(..., precision=False)")


class _Wanted(NamedTuple):
    """How to solve."""

    method: str
    rule: AbstractStoppingRule
    max_iterations: int
    engine: str
    reduced: Method
    devices: int | None
    progress: Callable[[Progress], None] | None


def _least_squares(block: Block, wanted: _Wanted, precision: bool, checkpoint: Path | None) -> Adjustment:
    """One adjustment."""
    block = with_datum(block)
    method, rule = wanted.method, wanted.rule
    origin = jax.lax.stop_gradient(on_host(block.exterior.projection_centre).mean(0))
    centred = block.moved(-origin)
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    centres = np.asarray(block.exterior.projection_centre) if block.concrete else None
    devices = wanted.devices or _useful_devices(block)
    plan = arrange(block.structure, block.groups, centres, devices, wanted.reduced, precision)
    arguments = Arguments(problem(plan, centred), rule.arranged(plan.order))
    if wanted.engine == "jaxopt":
        # jaxopt warns at import that it is no longer developed: only who asks for it shall load it
        second_opinion = importlib.import_module("jaxbundle.solve.second_opinion")
        args = second_opinion.Arguments(observations_of(centred), rule)
        unknowns, iterations = second_opinion.solve(unknowns_of(centred), args, method, wanted.max_iterations)
        arranged = arranged_unknowns(plan, unknowns)
    else:
        run = _Run(centred, plan, arguments, method, wanted.max_iterations, optimised)
        if block.concrete:
            keeper = None if checkpoint is None else Keeper(checkpoint, fingerprint(block, method))
            arranged, iterations = _step_by_step(run, wanted.progress, keeper)
        else:
            arranged, iterations = _in_one(run)
    if block.structure.datum.kind == "inner":
        arranged = arranged_unknowns(plan, constrained(centred, restored_unknowns(plan, arranged)))
        block = dataclasses.replace(block, structure=freed(block.structure))
    return adjustment(
        block, plan, arguments.problem, arranged, iterations, origin, rule.name, method, precision, optimised
    )


def _useful_devices(block: Block) -> int:
    """Devices worth dealing the tiles to: a small block loses more to their exchange than it gains."""
    return jax.local_device_count() if len(block.structure.ray_image) >= RAYS_FOR_DEVICES else 1


class _Run(NamedTuple):
    """What a solve needs."""

    block: Block
    plan: Arrangement
    args: Arguments
    method: str
    max_iterations: int
    optimised: bool


def _in_one(run: _Run) -> tuple[Arranged, Iterations]:
    """All steps in one program, as tracing needs it; under vmap one block after the other.

    Measured: a block's arrays are long enough by themselves, those of many blocks together leave the processor's cache.
    """
    bundle = BundleSolver(METHODS[run.method]())

    @sequential_vmap
    def solved(unknowns: Arranged, args: Arguments) -> tuple[Arranged, State]:
        return solver.run(bundle, unknowns, args, bundle.first(), run.max_iterations, optimised=run.optimised)

    unknowns, state = solved(arranged_unknowns(run.plan, unknowns_of(run.block)), run.args)
    codes = jnp.array([_STATUS[k] for k in range(len(_STATUS))])
    return unknowns, _iterations(state, codes[state.status])


def _step_by_step(
    run: _Run, progress: Callable[[Progress], None] | None, keeper: Keeper | None
) -> tuple[Arranged, Iterations]:
    """One step a call, so that a user can look on, stop it, and go on from a checkpoint."""
    bundle = BundleSolver(METHODS[run.method]())
    start, state = unknowns_of(run.block), bundle.first()
    if keeper is not None:
        start, state = keeper.resumed(start, state)
    unknowns, problem, state = placed(arranged_unknowns(run.plan, start), run.args.problem, state)
    args, interrupted = run.args._replace(problem=problem), False
    try:
        while int(state.trials) < run.max_iterations and int(state.status) == solver.RUNNING:
            before = int(state.accepted)
            unknowns, state = solver.run(bundle, unknowns, args, state, 1, optimised=run.optimised)
            accepted = int(state.accepted) > before
            if progress is not None:
                progress(_progress(run.block, state, accepted))
            if keeper is not None and (accepted or int(state.status) != solver.RUNNING):
                keeper.keep(restored_unknowns(run.plan, unknowns), state)
    except KeyboardInterrupt:
        interrupted = True
    status = Status.INTERRUPTED if interrupted else _STATUS[int(state.status)]
    return unknowns, _iterations(state, on_device(int(status)))


def _iterations(state: State, status: Array) -> Iterations:
    return Iterations(status, state.trials, state.accepted, state.initial_cost, state.cost, state.measure)


def _progress(block: Block, state: State, accepted: bool) -> Progress:
    cost = float(state.cost)
    sigma0 = float(np.sqrt(2 * cost / block.redundancy))
    return Progress(int(state.trials), cost, float(state.used_damping), float(state.step), accepted, sigma0)
