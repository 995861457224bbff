"""The bundle solver: Gauss-Newton and Levenberg-Marquardt on reduced normal equations, run by `optx.least_squares`.

One step:  rows and elimination at the accepted unknowns -> reduced solution -> back-substitution -> trial -> verdict.

It uses from optimistix the driver (`optx.least_squares`: the loop, the maximum number of steps, the check for numbers
that are not finite), the protocol of a solver, RESULTS and the Solution with its statistics. It does not use `fn`: the
residuals are evaluated inside the elimination, from the problem in `args`. Derivatives of the minimum come from
`solve/implicit.py`, not from an adjoint of optimistix.

    RESULTS.successful                      converged
    RESULTS.singular                        an undamped step of Gauss-Newton had no finite solution
    RESULTS.nonlinear_divergence            an undamped step of Gauss-Newton made the residuals larger
    RESULTS.stagnation                      no damped step reduces the residuals further
    RESULTS.nonlinear_max_steps_reached     none of these after `max_steps` steps

Only accepted unknowns are linearised, and the Jacobian is not part of the state. Convergence is confirmed by
an undamped step: if a damped step meets the stopping rule, the next one is tried with lambda = 0, and the solve ends
    when this one also meets the rule. If the undamped equations are singular, a damped step is not sufficient, since a
    large lambda makes any step short: then the gradient must vanish,

    |J_k^T P v| <= 1e-8 |J_k| |v| + rounding         for each unknown k, free of units
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.normals.cost import weighted_residuals
from jaxbundle.normals.problem import OrderedUnknowns, Problem
from jaxbundle.normals.step import trial_step
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, on_host_or_traced
from jaxbundle.solve.damping import AbstractDamping, DampingState
from jaxbundle.solve.history import History, empty_history, entry
from jaxbundle.solve.stopping_rules import AbstractStoppingRule, StepTaken

RESULTS = optx.RESULTS
# a type checker assigns these names to lineax; `promote` would start JAX at import
_SINGULAR: Any = RESULTS.singular
_STAGNATION: Any = RESULTS.stagnation
FLAT = 1e-8  # cosine of the angle between v and the column of an unknown: same limit as the angle rule
MAX_DAMPING = 1e16  # maximum damping: with more, a step does not change the unknowns in double precision


class Arguments(NamedTuple):
    """Content of `args`: arrays and the functions that use them, without names."""

    problem: Problem
    rule: AbstractStoppingRule


class State(NamedTuple):
    """State of the solver.

    Damping and certificate change with each trial; cost (v^T P v / 2) and measure with accepted ones.
    """

    damping: DampingState
    certifying: Bool[Array, ""]  # the next step is undamped
    uncertified: Bool[Array, ""]  # the undamped step was singular: the gradient replaces it as criterion
    ended: Bool[Array, ""]
    result: optx.RESULTS  # result of an ended solve, otherwise "successful"
    trials: Int[Array, ""]
    accepted: Int[Array, ""]
    used_damping: Float[Array, ""]
    initial_cost: Float[Array, ""]
    cost: Float[Array, ""]
    measure: Float[Array, ""]
    step: Float[Array, ""]  # |J d| / |v| of the last trial
    history: History | None  # None where the host collects it


class Solved(NamedTuple):
    """The unknowns after some steps, the state to resume from, and the result so far."""

    unknowns: OrderedUnknowns
    state: State
    result: optx.RESULTS


class BundleSolver(optx.AbstractLeastSquaresSolver[OrderedUnknowns, Any, Any, State]):
    """Block-sparse least squares for `optx.least_squares`; `options["state"]` continues an interrupted solve."""

    rtol: float
    atol: float
    norm: Any = eqx.field(static=True)
    damping: AbstractDamping

    def __init__(self, damping: AbstractDamping):
        # optimistix requires these; the stopping rule is in `args`
        self.rtol, self.atol, self.norm = 0.0, 0.0, optx.max_norm
        self.damping = damping

    def first(self, recorded: int | None = None) -> State:
        """The state before the first step, with room for the history of `recorded` iterations."""
        false, zero, nan, running = on_device((False, 0, jnp.nan, RESULTS.successful))
        history, start = None if recorded is None else empty_history(recorded), self.damping.initial_state()
        return State(start, false, false, false, running, zero, zero, nan, nan, nan, nan, nan, history)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> State:
        return options["state"] if "state" in options else self.first()

    def step(
        self, fn, y: OrderedUnknowns, args: Arguments, options, state: State, tags
    ) -> tuple[OrderedUnknowns, State, Any]:
        problem, rule = args
        factor = jnp.where(state.certifying, 0.0, state.damping.factor)
        trial = trial_step(y, problem, factor)
        change = jnp.maximum(trial.residual_change - 2 * trial.noise, 0.0)
        angle_squared = jnp.where(trial.cost > 0, change / (2 * trial.cost), 0.0)  # no residuals: none can change
        accepted, damping = self.damping.judge_step(
            state.damping, trial.reduction, trial.predicted, trial.cost, trial.noise
        )
        accepted = accepted & trial.finite
        # a confirming step has no information about the damping
        damping = jax.tree.map(lambda old, new: jnp.where(state.certifying, old, new), state.damping, damping)
        unknowns = jax.tree.map(lambda old, new: jnp.where(accepted, new, old), y, trial.unknowns)
        measure = rule.measure(StepTaken(y.flat(), trial.unknowns.flat(), angle_squared, problem.observations))
        met = accepted & (measure <= rule.limit)
        # at other unknowns the next undamped step may be regular
        left = accepted & ~met
        uncertified = jnp.where(state.certifying, ~trial.finite, state.uncertified & ~left)
        undamped = factor == 0
        flat = is_flat(trial.steepness, trial.cost, trial.noise, FLAT)
        converged = met & (undamped | (uncertified & flat))
        stalled = ~converged & (damping.factor > MAX_DAMPING)
        hopeless = undamped & ~state.certifying & ~accepted  # Gauss-Newton has no shorter step
        diverged = RESULTS.where(trial.finite, RESULTS.nonlinear_divergence, _SINGULAR)
        result = RESULTS.where(stalled, _STAGNATION, RESULTS.successful)
        cost, length = jnp.where(accepted, trial.cost - trial.reduction, trial.cost), jnp.sqrt(angle_squared)
        history = state.history
        if history is not None:
            history = history.with_entry(state.trials, entry(cost, factor, length, accepted))
        return (
            unknowns,
            State(
                damping,
                met & ~undamped & ~uncertified,
                uncertified,
                converged | stalled | hopeless,
                RESULTS.where(hopeless, diverged, result),
                state.trials + 1,
                state.accepted + accepted.astype(state.accepted.dtype),
                factor,
                jnp.where(state.trials == 0, trial.cost, state.initial_cost),
                cost,
                jnp.where(accepted, measure, state.measure),
                length,
                history,
            ),
            None,
        )

    def terminate(self, fn, y, args, options, state: State, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        return state.ended, state.result

    def postprocess(self, fn, y, aux, args, options, state: State, tags, result) -> tuple[OrderedUnknowns, Any, dict]:
        numbers = ("trials", "accepted", "initial_cost", "cost", "measure", "step")
        return y, aux, {name: getattr(state, name) for name in numbers}


@on_host_or_traced
def is_flat(xp: Any, steepness: Any, cost: Any, noise: Any, tolerance: Any) -> Any:
    """Whether the gradient vanishes: max |J_k^T P v| / |J_k| compared with |v| and its rounding, from v^T P v / 2."""
    return steepness <= tolerance * xp.sqrt(2 * cost) + xp.sqrt(2 * noise)


@Compiled
def run(solver: BundleSolver, unknowns: OrderedUnknowns, args: Arguments, state: State, max_steps: int) -> Solved:
    """Makes at most `max_steps` steps from a state; `max_steps` is static."""

    def residuals(unknowns: OrderedUnknowns, args: Arguments) -> list[Array]:
        return weighted_residuals(unknowns, args.problem)

    solution = optx.least_squares(residuals, solver, unknowns, args, {"state": state}, max_steps=max_steps, throw=False)
    return Solved(solution.value, solution.state, solution.result)
