"""The function `adjust`: from a block to its adjustment."""

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, Unpack

import jax
import numpy as np
import optimistix as optx
from jax.custom_batching import sequential_vmap
from jaxtyping import Array

from jaxbundle.block.block import Block
from jaxbundle.block.consistency import require_consistent
from jaxbundle.block.datum import with_datum
from jaxbundle.block.datum_precision import weak_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.residuals import observations_of
from jaxbundle.block.unknowns import known_centres, unknowns_of
from jaxbundle.block.validate import require_valid
from jaxbundle.normals.from_block import problem, to_block_order, to_elimination_order
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.plan.known_plans import planned
from jaxbundle.normals.problem import OrderedUnknowns
from jaxbundle.normals.step import placed
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION
from jaxbundle.numerics.host import constant, on_device, on_host, on_host_or_traced
from jaxbundle.solve import levenberg_marquardt as solver
from jaxbundle.solve.adjustment import Adjustment, Iterations, Status
from jaxbundle.solve.answer import Ended, adjustment
from jaxbundle.solve.checkpoint import Checkpointer, fingerprint, require_same_block
from jaxbundle.solve.damping import Marquardt, Undamped
from jaxbundle.solve.free_network import constrained, freed
from jaxbundle.solve.history import History, HistoryEntry, history_of
from jaxbundle.solve.implicit import minimum
from jaxbundle.solve.initial_state import require_finite_start
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, Solved, State
from jaxbundle.solve.options import Choices, Options, chosen
from jaxbundle.solve.reweighting import Solve, adjust_robustly
from jaxbundle.solve.status import status_of
from jaxbundle.solve.stopping_rules import AbstractStoppingRule
from jaxbundle.solve.verdict import with_verdict

DAMPINGS = {"levenberg-marquardt": Marquardt, "gauss-newton": Undamped}
RAYS_FOR_DEVICES = 10_000
UNDAMPED_STEPS = 30  # maximum number of full steps where damped ones creep
CREEPING_STEPS = 10  # both methods need fewer iterations where the datum is determined


Phase = Literal["planning", "compiling", "iterating", "standard deviations"]
"""Phases of an adjustment: the first iteration compiles its program, unless an equal block was adjusted before."""


class Progress(NamedTuple):
    """State after one iteration, for a progress callback; `step` is |J d| / |v|.

    Example:
        >>> steps = []
        >>> _ = jb.adjust(block, progress=steps.append)
        >>> steps[0].iteration, steps[0].accepted
        (1, True)
    """

    iteration: int
    cost: float
    damping: float
    step: float
    accepted: bool
    sigma0: float
    ended: bool = False
    """Whether this is the last iteration; standard deviations follow."""


def adjust(
    block: Block,
    options: Options | None = None,
    *,
    checkpoint: Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    phase: Callable[[Phase], None] | None = None,
    **choices: Unpack[Choices],
) -> Adjustment:
    """Adjusts a block by least squares, starting from its values.

    Args:
        block: the block.
        options: options, such as `result.options` of another adjustment; the defaults if None. Keywords change single
            options.
        method: "levenberg-marquardt" or "gauss-newton".
        stop: a stopping rule, AngleRule() if None.
        max_iterations: maximum number of iterations, default 200.
        precision: whether cofactors and standard deviations are computed, default True.
        engine: "block", or "jaxopt", an independent solver for small blocks.
        reduced: solver of the reduced normal equations, "dense", "panels" or "pcg" (conjugate gradients, which give no
            standard deviations), "auto" chooses by size.
        devices: number of JAX devices for the points, in all processes; if None all devices, or one for a small
            block.
        robust: a weight function for gross errors in the rays, such as Huber(); the result has the weights in
            `reweighting`.
        derivatives: derivatives of the minimum under grad, jacfwd or jacrev: "exact", or "gauss-newton", which
            neglects the second derivatives of the observations.
        checkpoint: a file for the state after each accepted iteration; if it exists, the adjustment resumes from
            it.
        progress: a function that is called after each iteration.
        phase: a function that is called with the name of each phase when it begins.

    Returns: the adjustment, with its options. After Ctrl-C, or a KeyboardInterrupt in `progress`, it has the last
    accepted unknowns, without standard deviations.

    Raises: TypeError for an object that is not a Block, or an unknown option; BlockError with all problems of the
    block; CheckpointError for a checkpoint of another block; ValueError for an unknown name or without float64;
    KeyboardInterrupt if it came before the first accepted step.

    Example:
        >>> result = jb.adjust(jb.read("quarry"))
        >>> result.status.name, round(float(result.sigma0), 3)
        ('CONVERGED', 0.957)
    """
    require_a(Block, block, "adjust")
    wanted = chosen(options, choices, "adjust")
    values = constant(block)
    if values.concrete:
        require_valid(values)
        require_same_block(values, wanted.method)
    else:
        require_consistent(values)
    if wanted.robust is None:
        found = _least_squares(block, wanted, _Watch(checkpoint, progress, phase))
        return with_verdict(found) if block.concrete else found
    if checkpoint is not None:
        raise ValueError("`checkpoint` is not supported together with `robust`")
    watch, fully = _Watch(None, progress, phase), dataclasses.replace(wanted, robust=None)
    quickly = dataclasses.replace(fully, precision=False)
    solve = Solve(
        lambda b: _least_squares(b, quickly, watch, inspected=False), lambda b: _least_squares(b, fully, watch)
    )
    return with_verdict(dataclasses.replace(adjust_robustly(block, wanted.robust, solve), options=wanted))


class _Watch(NamedTuple):
    """Outcome of one solve."""

    checkpoint: Path | None
    progress: Callable[[Progress], None] | None
    phase: Callable[[Phase], None] | None = None

    def begins(self, phase: Phase) -> None:
        """Reports the begin of a phase."""
        if self.phase is not None:
            self.phase(phase)


def _least_squares(block: Block, options: Options, watch: _Watch, inspected: bool = True) -> Adjustment:
    """One adjustment; with `inspected` false its answer is not checked, for internal results."""
    differentiable = not block.concrete
    if block.structure.datum.kind == "inner" and differentiable:
        raise ValueError("a free network cannot be adjusted inside jit, grad and vmap; use a minimal datum there")
    values = with_datum(constant(block))
    block = dataclasses.replace(block, structure=values.structure) if differentiable else values
    origin = on_host(values.exterior.projection_centre).mean(0)
    centred = values.moved(-origin)
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    centres, devices, precision = known_centres(values), devices_of(values, options.devices), options.precision
    watch.begins("planning")
    plan = planned(block.structure, block.groups, centres, devices, options.reduced, direct=precision)
    rule = options.stop.of(centred)
    run = _Run(centred, plan, Arguments(problem(plan, centred), rule.arranged(plan.order)), optimised, options, watch)
    watch.begins("compiling")
    arranged, iterations = _solved(run, rule)
    given = run.args.problem
    if not differentiable:  # an interruption returns immediately
        precision = precision and int(iterations.status) != Status.INTERRUPTED
    else:
        centred = block.moved(-origin)
        given, start = problem(plan, centred), to_elimination_order(plan, unknowns_of(centred))
        converged = iterations.status == Status.CONVERGED
        arranged = minimum(arranged, start, given, converged, options.derivatives, optimised)
    if block.structure.datum.kind == "inner":
        arranged = to_elimination_order(plan, constrained(centred, to_block_order(plan, arranged)))
        block = dataclasses.replace(block, structure=freed(block.structure))
    if precision:
        watch.begins("standard deviations")
    ended = Ended(iterations, origin, options, precision, inspected, differentiable, optimised)
    return adjustment(block, plan, given, arranged, ended)


def _solved(run: "_Run", rule: AbstractStoppingRule) -> tuple[OrderedUnknowns, Iterations]:
    """Iterates to the minimum. `rule`: in the order of the block."""
    block, options, checkpoint = run.block, run.options, run.watch.checkpoint
    if options.engine == "jaxopt":
        # jaxopt warns at import that it is no longer developed: it is imported only on request
        second_opinion = importlib.import_module("jaxbundle.solve.second_opinion")
        args = second_opinion.Arguments(observations_of(block), rule)
        unknowns, iterations = second_opinion.solve(unknowns_of(block), args, options.method, options.max_iterations)
        if not np.isfinite(float(iterations.initial_cost)):
            start = to_elimination_order(run.plan, unknowns_of(block))
            require_finite_start(block, run.plan, start, run.args.problem)
        return to_elimination_order(run.plan, unknowns), iterations
    if not block.concrete:
        return _in_one(run)
    saved = None if checkpoint is None else Checkpointer(checkpoint, fingerprint(block, options.method))
    return _step_by_step(run, saved)


def devices_of(block: Block, wanted: int | None) -> int:
    """Devices for the tiles. For a small block the communication costs more than it saves: one by default.

    Raises: ValueError for a number of devices that does not exist, or that would leave a process without work.
    """
    there, processes, concrete = jax.device_count(), jax.process_count(), block.concrete
    if wanted is None:
        useful = len(block.structure.ray_image) >= RAYS_FOR_DEVICES and (processes == 1 or concrete)
        return there if useful else 1
    if not 1 <= wanted <= there:
        raise ValueError(f"devices={wanted}, but JAX has {there}; give 1 to {there}, or set jax_num_cpu_devices before")
    if processes > 1 and wanted not in (1, there):
        raise ValueError(f"devices={wanted} leave some of {processes} processes idle; give {there} (all) or 1")
    if processes > 1 and wanted > 1 and not concrete:
        raise ValueError(f"under jit, grad and vmap each of {processes} processes computes alone; give devices=1")
    return wanted


class _Run(NamedTuple):
    """Input of a solve."""

    block: Block
    plan: EliminationPlan
    args: Arguments
    optimised: bool
    options: Options
    watch: _Watch


def _in_one(run: _Run) -> tuple[OrderedUnknowns, Iterations]:
    """All steps in one program, for tracing; under vmap one block after the other.

    Measured: the arrays of one block are long enough for vectorisation; those of many blocks exceed the processor's
        cache.
    """
    bundle, most = BundleSolver(DAMPINGS[run.options.method]()), run.options.max_iterations

    @sequential_vmap
    def solved(unknowns: OrderedUnknowns, args: Arguments) -> Solved:
        return solver.run(bundle, unknowns, args, bundle.first(most), most, optimised=run.optimised)

    found = solved(to_elimination_order(run.plan, unknowns_of(run.block)), run.args)
    history = found.state.history
    assert history is not None
    return found.unknowns, _iterations(found.state, status_of(found.result), history)


def _step_by_step(run: _Run, checkpointer: Checkpointer | None) -> tuple[OrderedUnknowns, Iterations]:
    """One step per call, so that progress can be shown, the solve can be stopped and resumed from a checkpoint."""
    bundle, most, progress = (
        BundleSolver(DAMPINGS[run.options.method]()),
        run.options.max_iterations,
        run.watch.progress,
    )
    start, state = unknowns_of(run.block), bundle.first()
    if checkpointer is not None:
        start, state = checkpointer.resumed(start, state)
        new = bundle.first()
        state = state._replace(ended=new.ended, result=new.result)  # the status in a file is not used
    unknowns, problem, state = placed(to_elimination_order(run.plan, start), run.args.problem, state)
    found = Solved(unknowns, state, optx.RESULTS.nonlinear_max_steps_reached)
    args, interrupted, costs, creeping = run.args._replace(problem=problem), False, [], False
    entries: list[HistoryEntry] = []
    try:
        while int(found.state.trials) < most and not bool(found.state.ended) and not creeping:
            before = int(found.state.accepted)
            found = solver.run(bundle, found.unknowns, args, found.state, 1, optimised=run.optimised)
            state = found.state
            if int(state.trials) == 1 and not np.isfinite(float(state.initial_cost)):
                require_finite_start(run.block, run.plan, found.unknowns, args.problem)
            accepted = int(state.accepted) > before
            entries.append(_entry(state, accepted))
            if checkpointer is not None and accepted and not bool(state.ended):
                # the last step is not saved: a resumed solve repeats it with the same result
                checkpointer.save(to_block_order(run.plan, found.unknowns), state)
            if progress is not None:
                progress(_progress(run.block, state, accepted))
            if len(entries) == 1:
                run.watch.begins("iterating")
            if accepted:
                costs.append(float(state.cost))
                creeping = is_creeping(run.block, costs)
    except KeyboardInterrupt:
        if jax.process_count() > 1 or not int(found.state.accepted):
            raise  # the other processes would wait for ever; or there is no accepted step
        interrupted = not bool(found.state.ended)
    if creeping:
        further, full_steps = _undamped(run, found, args)
        if further is not None:
            found, creeping, entries = further, False, [*entries, *full_steps]
    state, result = on_device(on_host((found.state, found.result)))
    status = Status.INTERRUPTED if interrupted else Status(int(status_of(result)))
    if creeping and status is Status.MAXIMUM_ITERATIONS:
        status = Status.CREEPING
    return found.unknowns, _iterations(state, on_device(int(status)), history_of(entries, most))


def _undamped(run: _Run, found: Solved, args: Arguments) -> tuple[Solved | None, list[HistoryEntry]]:
    """Full Gauss-Newton steps from a point at which damped ones creep, with their entries in the history.

    None unless they converge, at a smaller cost.
    """
    damping, entries = Undamped(), []
    bundle, further = BundleSolver(damping), found._replace(state=found.state._replace(damping=damping.initial_state()))
    for _ in range(min(UNDAMPED_STEPS, run.options.max_iterations - int(found.state.trials))):
        further = solver.run(bundle, further.unknowns, args, further.state, 1, optimised=run.optimised)
        entries.append(_entry(further.state, True))  # without an accepted step the solve ends, and is not used
        if bool(further.state.ended):
            break
    converged = bool(further.state.ended) and int(status_of(further.result)) == Status.CONVERGED
    smaller = float(further.state.cost) <= float(found.state.cost)
    return (further if converged and smaller else None), entries


def is_creeping(block: Block, costs: list[float]) -> bool:
    """Whether the last steps only follow a weak direction of the datum.

    Then v^T P v falls by less than the effect of one standard deviation of an unknown, and control determines this
    direction too weakly to be usable.
    """
    if len(costs) <= CREEPING_STEPS or len(costs) % CREEPING_STEPS:
        return False
    fallen, variance = 2 * (costs[-1 - CREEPING_STEPS] - costs[-1]), 2 * costs[-1] / max(block.redundancy, 1)
    return fallen < variance and bool(weak_datum(block, float(np.sqrt(variance))))


def _entry(state: State, accepted: bool) -> HistoryEntry:
    return int(state.trials) - 1, float(state.cost), float(state.used_damping), float(state.step), accepted


def _iterations(state: State, status: Array, history: History) -> Iterations:
    costs = state.initial_cost, state.cost
    return Iterations(status, state.trials, state.accepted, *costs, state.measure, _undamped_step(state), history)


@on_host_or_traced
def _undamped_step(xp: Any, state: State) -> Any:
    """The length of the last step; 0 if it was damped."""
    return xp.where(state.used_damping == 0, state.step, 0.0)


def _progress(block: Block, state: State, accepted: bool) -> Progress:
    cost = float(state.cost)
    sigma0 = float(np.sqrt(2 * cost / block.redundancy))
    numbers = cost, float(state.used_damping), float(state.step)
    return Progress(int(state.trials), *numbers, accepted, sigma0, bool(state.ended))
