"""An independent solver for small blocks: jaxopt's dense Gauss-Newton and Levenberg-Marquardt.

No unknowns are eliminated. All free corrections form one vector x, scaled by the columns of the design matrix A at the
unknowns of the start, so that these columns have length 1:

    v(x) = v(unknowns + x / |columns of A|)           weighted residuals

As corrections contain small angles, they are applied after a few steps, and the next round starts from 0. jaxopt does
not decide whether a round has converged: a dense Gauss-Newton step from its result must meet the stopping rule.
"""

from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxopt
from jax import lax
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.design import (
    MAX_UNKNOWNS,
    after_corrections,
    design_columns,
    free_numbers,
    no_corrections,
    residuals_after,
)
from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.solve.adjustment import Iterations, Status
from jaxbundle.solve.history import empty_history
from jaxbundle.solve.stopping_rules import AbstractStoppingRule, StepTaken

STEPS_A_ROUND = 10
AT_REST = 1e-12  # share of |v|: a round ends where its gradient or its step, in units of v, is smaller


class Arguments(NamedTuple):
    """The observations in the order of the block, and the rule that ends the solve."""

    observations: Observations
    rule: AbstractStoppingRule


class FullStep(NamedTuple):
    """A dense Gauss-Newton step and the lengths of the columns that scale it.

    `measure`: value of the stopping rule for the step; `met`: whether it is within the limit, or below the resolution
    of jaxopt; `angle`: |J d| / |v|.
    """

    x: Float[Array, " free"]
    scale: Float[Array, " free"]
    measure: Float[Array, ""]
    met: Bool[Array, ""]
    angle: Float[Array, ""]


def solve(unknowns: Unknowns, args: Arguments, method: str, max_iterations: int) -> tuple[Unknowns, Iterations]:
    """Minimises the weighted residuals by jaxopt; `method` as in `adjust`.

    Raises: ValueError for a large block, and under tracing.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((unknowns, args))):
        raise ValueError('engine "jaxopt" does not work inside jit, grad and vmap; use engine "block" there')
    o = args.observations
    free = jnp.asarray(free_numbers(o))
    if len(free) > MAX_UNKNOWNS:
        raise ValueError(
            f'engine "jaxopt" uses a dense Jacobian and is limited to {MAX_UNKNOWNS} unknowns; the block has'
            f' {len(free)}; use engine "block"'
        )
    initial, status, trials, accepted = _cost(unknowns, o), Status.MAXIMUM_ITERATIONS, 0, 0
    full = _full_step(unknowns, args, free)
    while status is Status.MAXIMUM_ITERATIONS and trials < max_iterations:
        steps = min(STEPS_A_ROUND, max_iterations - trials)
        x, tried, moved = _round(unknowns, o, free, full.scale, method, jnp.asarray(steps))
        trials, accepted = trials + int(tried), accepted + int(moved)
        if not jnp.isfinite(x).all():
            status = Status.DIVERGED
            break
        unknowns = _moved(unknowns, o, free, x / full.scale)
        full = _full_step(unknowns, args, free)
        if full.met:
            status = Status.CONVERGED
        elif not jnp.isfinite(full.x).all():
            status = Status.SINGULAR
        elif not moved:
            status = Status.STALLED
    code, trials, accepted = jnp.asarray(int(status)), jnp.asarray(trials), jnp.asarray(accepted)
    costs, history = (
        (initial, _cost(unknowns, o)),
        empty_history(max_iterations),
    )  # jaxopt reports rounds, not iterations
    return unknowns, Iterations(code, trials, accepted, *costs, full.measure, full.angle, history)


def _residuals(unknowns: Unknowns, observations: Observations) -> Float[Array, " observation"]:
    return residuals_after(unknowns, observations)(no_corrections(observations))


@eqx.filter_jit
def _cost(unknowns: Unknowns, observations: Observations) -> Float[Array, ""]:
    return 0.5 * jnp.sum(_residuals(unknowns, observations) ** 2)


@eqx.filter_jit
def _moved(unknowns: Unknowns, o: Observations, free: Int[Array, " free"], d: Float[Array, " free"]) -> Unknowns:
    """The unknowns after a correction of the free elements."""
    flat, corrections = ravel_pytree(no_corrections(o))
    return after_corrections(unknowns, o, corrections(flat.at[free].set(d)))


@eqx.filter_jit
def _round(
    unknowns: Unknowns,
    o: Observations,
    free: Int[Array, " free"],
    scale: Float[Array, " free"],
    method: str,
    steps: Int[Array, ""],
) -> tuple[Float[Array, " free"], Int[Array, ""], Int[Array, ""]]:
    """Some steps of jaxopt's solver: scaled corrections, number of steps, and number of steps that changed them."""

    def residuals(x: Float[Array, " free"]) -> Float[Array, " observation"]:
        return _residuals(_moved(unknowns, o, free, x / scale), o)

    solver: Any
    if method == "gauss-newton":
        solver = jaxopt.GaussNewton(residuals, implicit_diff=False)
    else:
        solver = jaxopt.LevenbergMarquardt(residuals, solver="cholesky", materialize_jac=True, implicit_diff=False)
    start, zero = jnp.zeros(free.shape), jnp.asarray(0)
    at_rest = AT_REST * jnp.linalg.norm(residuals(start))

    def moving(carry: tuple) -> Array:
        _, state, tried, _ = carry
        return (tried < steps) & (state.error > at_rest)

    def step(carry: tuple) -> tuple:
        x, state, tried, moved = carry
        with _promotion_of_jaxopt():
            new, state = solver.update(x, state)
        return new, state, tried + 1, moved + jnp.any(new != x).astype(moved.dtype)

    x, _, tried, moved = lax.while_loop(moving, step, (start, solver.init_state(start), zero, zero))
    return x, tried, moved


def _promotion_of_jaxopt() -> AbstractContextManager:
    """JAX's usual promotion of types: jaxopt multiplies masks by numbers, which JAX refuses where a user forbids it."""
    return jax.numpy_dtype_promotion("standard")


@eqx.filter_jit
def _full_step(unknowns: Unknowns, args: Arguments, free: Int[Array, " free"]) -> FullStep:
    """The Gauss-Newton step by QR of the dense design matrix."""
    o, rule = args.observations, args.rule

    v, design = _residuals(unknowns, o), design_columns(unknowns, o, free[None]).T
    length = jnp.linalg.norm(design, axis=0)
    scale = jnp.where(length > 0, length, 1.0)
    q, r = jnp.linalg.qr(design / scale[None])
    tangential = q.T @ v  # same length as A d
    x = -solve_triangular(r, tangential)
    # rounding of the image coordinates: shorter steps cannot be distinguished from 0
    noise = jnp.sum((4 * jnp.finfo(v.dtype).eps * o.coordinates * o.weights) ** 2)
    angle_squared = jnp.maximum(jnp.sum(tangential**2) - noise, 0.0) / jnp.sum(v**2)
    measure = rule.measure(StepTaken(unknowns, _moved(unknowns, o, free, x / scale), angle_squared, o))
    # jaxopt subtracts two sums of squares: it cannot detect changes in their last digits
    at_floor = angle_squared <= 16 * jnp.finfo(v.dtype).eps
    return FullStep(x, scale, measure, (measure <= rule.limit) | at_floor, jnp.sqrt(angle_squared))
