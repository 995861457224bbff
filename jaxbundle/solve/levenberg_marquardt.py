"""The bundle solver: Gauss-Newton and Levenberg-Marquardt on eliminated normal equations, run by `optx.least_squares`.

One step:  rows and elimination at the accepted unknowns -> reduced solution -> back-substitution -> trial -> verdict.

Only accepted unknowns are linearised and the Jacobian is not kept, so the state is free of it. Convergence is
certified by an undamped step: where a damped step meets the stopping rule the next one is tried with lambda = 0, and
the solve ends when that one meets the rule too.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.residuals import Observations, weighted_residuals
from jaxbundle.block.unknowns import Unknowns, corrected
from jaxbundle.normals import reduced, schur
from jaxbundle.normals.plan import Plan
from jaxbundle.solve.search import AbstractSearch, SearchState
from jaxbundle.solve.stopping import AbstractStoppingRule, StepTaken

RUNNING, CONVERGED, SINGULAR, DIVERGED, STALLED = range(5)
LARGEST_DAMPING = 1e16  # beyond, a step no longer changes the unknowns in double precision


class Arguments(NamedTuple):
    """What travels through `args`: arrays and the functions they are put into, no names."""

    observations: Observations
    plan: Plan
    rule: AbstractStoppingRule


class State(NamedTuple):
    """Search and certificate change with every trial; cost (v^T P v / 2) and measure with accepted ones."""

    search: SearchState
    certifying: Bool[Array, ""]  # the next step is undamped
    uncertified: Bool[Array, ""]  # an undamped step was singular: the rule must do with damped ones
    status: Int[Array, ""]
    trials: Int[Array, ""]
    accepted: Int[Array, ""]
    used_damping: Float[Array, ""]
    cost: Float[Array, ""]
    measure: Float[Array, ""]
    step: Float[Array, ""]  # |J d| / |v| of the last trial


class Trial(NamedTuple):
    """A trial step at some damping; all reductions belong to v^T P v / 2."""

    unknowns: Unknowns
    cost: Float[Array, ""]
    reduction: Float[Array, ""]
    predicted: Float[Array, ""]
    angle_squared: Float[Array, ""]
    noise: Float[Array, ""]
    finite: Bool[Array, ""]


def trial_step(unknowns: Unknowns, observations: Observations, plan: Plan, damping: Float[Array, ""]) -> Trial:
    """Linearises, eliminates, solves, substitutes back and evaluates."""
    t = schur.tables(unknowns, observations)
    e = schur.eliminate(t, plan, damping)
    factor = reduced.factorise(e.reduced, e.diagonal, damping, schur.free_columns(observations, plan))
    step = schur.back_substitute(t, plan, e, damping, reduced.solve(factor, e.right))
    moved = corrected(unknowns, step.correction, observations.in_angles, observations.system)
    pairs = list(zip(weighted_residuals(unknowns, observations), weighted_residuals(moved, observations), strict=True))
    cost = 0.5 * sum(jnp.sum(v * v) for v, _ in pairs)
    # v^2 - w^2 as a product: the difference of two nearly equal sums would be noise near the minimum
    reduction = 0.5 * sum(jnp.sum((v - w) * (v + w)) for v, w in pairs)
    predicted = 0.5 * (step.damped_step - step.gradient_step)
    # rounding of the image equation, a few operations on image coordinates: no step can be told from 0 below it
    noise = 0.5 * jnp.sum((4 * jnp.finfo(cost.dtype).eps * observations.coordinates * observations.weights) ** 2)
    moved_residuals = -step.gradient_step - step.damped_step  # |J d|^2 = d.N d
    angle_squared = jnp.maximum(moved_residuals - noise, 0.0) / (2 * cost)
    return Trial(moved, cost, reduction, predicted, angle_squared, noise, step.finite)


class BundleSolver(optx.AbstractLeastSquaresSolver[Unknowns, Any, Any, State]):
    """Block-sparse least squares for `optx.least_squares`; `options["state"]` continues an interrupted solve."""

    search: AbstractSearch
    rtol: float = 0.0
    atol: float = 0.0
    norm: Any = eqx.field(static=True, default=optx.max_norm)

    def first(self, unknowns: Unknowns, args: Arguments) -> State:
        """The state before the first step."""
        cost = schur.cost(unknowns, args.observations)
        false, zero, nan = jnp.array(False), jnp.array(0), jnp.array(jnp.nan)
        state = State(self.search.first(), false, false, zero, zero, zero, nan, cost, nan, nan)
        # without weak types, which a step does not return: one compilation serves the first step and the others
        return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), state)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> State:
        return options["state"] if "state" in options else self.first(y, args)

    def step(self, fn, y: Unknowns, args: Arguments, options, state: State, tags) -> tuple[Unknowns, State, Any]:
        observations, plan, rule = args
        damping = jnp.where(state.certifying, 0.0, state.search.damping)
        trial = trial_step(y, observations, plan, damping)
        accepted, search = self.search.judge(state.search, trial.reduction, trial.predicted, trial.cost, trial.noise)
        accepted = accepted & trial.finite
        # a certifying step is no information about the damping
        search = jax.tree.map(lambda old, new: jnp.where(state.certifying, old, new), state.search, search)
        unknowns = jax.tree.map(lambda old, new: jnp.where(accepted, new, old), y, trial.unknowns)
        measure = rule.measure(StepTaken(y, trial.unknowns, trial.angle_squared, observations))
        met = accepted & (measure <= rule.limit)
        uncertified = state.uncertified | (state.certifying & ~trial.finite)
        undamped = damping == 0
        status = jnp.where(met & (undamped | uncertified), CONVERGED, RUNNING).astype(state.status.dtype)
        status = jnp.where((status == RUNNING) & (search.damping > LARGEST_DAMPING), STALLED, status)
        hopeless = undamped & ~state.certifying & ~accepted  # Gauss-Newton has no shorter step
        status = jnp.where(hopeless, jnp.where(trial.finite, DIVERGED, SINGULAR), status)
        return (
            unknowns,
            State(
                search,
                met & ~undamped & ~uncertified,
                uncertified,
                status,
                state.trials + 1,
                state.accepted + accepted,
                damping,
                jnp.where(accepted, trial.cost - trial.reduction, state.cost),
                jnp.where(accepted, measure, state.measure),
                jnp.sqrt(jnp.maximum(trial.angle_squared, 0.0)),
            ),
            None,
        )

    def terminate(self, fn, y, args, options, state: State, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        return state.status != RUNNING, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state: State, tags, result) -> tuple[Unknowns, Any, dict]:
        return y, aux, {"state": state}


@eqx.filter_jit
def run(
    solver: BundleSolver, unknowns: Unknowns, args: Arguments, state: State, max_steps: int
) -> tuple[Unknowns, State]:
    """At most `max_steps` steps from a state; `max_steps` is static."""

    def residuals(unknowns: Unknowns, args: Arguments) -> tuple[Array, ...]:
        return weighted_residuals(unknowns, args.observations)

    solution = optx.least_squares(residuals, solver, unknowns, args, {"state": state}, max_steps=max_steps, throw=False)
    return solution.value, solution.stats["state"]
