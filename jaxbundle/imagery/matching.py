"""Least-squares matching of a window in another image (Gruen 1985, Ackermann 1984).

    X = a0 + a1 x + a2 y,  Y = b0 + b1 x + b2 y        x, y from the reference point of the template f
    v = r0 + r1 g(X, Y) - f                            g the cubic spline of the searched image

Unknowns a0, a1, a2, b0, b1, b2, r0, r1. Gauss-Newton steps from a predicted position; rows by automatic
differentiation of the interpolant. The covariance of the position is that of a0 and b0:

    s0^2 = v^T v / (n - u),    Sigma = s0^2 N^-1

Affine parameters that a window does not determine reduce the precision and cause outliers. With "tested", only position
and radiometry are solved first, and the affine solution is used only if one of its four parameters differs by more than
three standard deviations from its start. If the grey values are traced by jit or grad, Newton steps with exact second
derivatives follow, so that the derivative is that of the minimum (implicit function).
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, ArrayLike, Bool, Float, Real

from jaxbundle.imagery import spline
from jaxbundle.imagery.match_types import DEFAULT, SCALE, SIGNIFICANT, Matches, MatchOptions, Refusal
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import is_concrete, on_device
from jaxbundle.numerics.nested import Nested
from jaxbundle.numerics.program_cache import prepare_jax

UNKNOWNS = 8
MAX_STEP = 1.0  # px: for larger steps the linearised grey values are meaningless
TOGETHER = 256  # windows per program call
PIXELS_FOR_OPTIMISATION = 500_000  # of all templates: below this, matching takes less time than optimising its program
NEWTON_STEPS = 4  # after Gauss-Newton, if derivatives are requested: the last steps are exact
FLAT = 1e-10  # reciprocal condition of scaled normal equations: below this they are undetermined


class Pair(NamedTuple):
    """A template with its reference point, and the searched window with the start (a0, a1, a2, b0, b1, b2)."""

    template: Float[Array, "height width"]
    searched: Float[Array, "row column"]
    reference: Float[Array, "2"]
    start: Float[Array, "6"]


class Limits(NamedTuple):
    """The limits of the options as arrays, so that one program is used for all."""

    max_iterations: Array
    settled: Array
    min_correlation: Array
    max_sigma: Array
    max_shift: Array


class Form(NamedTuple):
    """Static inputs of a program."""

    parameters: str
    bilinear: bool


class _State(NamedTuple):
    p: Array
    step: Array
    iterations: Array
    valid: Array


def match(
    templates: Real[ArrayLike, "match height width"] | Nested,
    searched: Real[ArrayLike, "match row column"] | Nested,
    references: Real[ArrayLike, "match 2"] | Nested,
    starts: Real[ArrayLike, "match 6"] | Nested,
    options: MatchOptions = DEFAULT,
) -> Matches:
    """Matches many windows at once by least squares, from predicted positions.

    It works with jit, grad and vmap. A search window should exceed the template by the expected shift and eight pixels
    on each side: near the border the mirrored pixels affect the spline.

    Args:
        templates: grey values around the points to measure.
        searched: grey values of the other image around the predicted positions.
        references: x, y of the point in the template, px from the corner of the template.
        starts: a0, a1, a2, b0, b1, b2; a0, b0 are the predicted position, px from the corner of the searched window.
        options: parameters, limits.

    Returns: positions with covariances, and for each match the reason if it is refused.

    Raises: ValueError for arrays with other shapes or without float64.

    Example:
        >>> start = [[17.8, 1, 0, 17.3, 0, 1]]
        >>> found = jb.imagery.match(texture[None, 12:23, 12:23], texture[None], [[5.5, 5.5]], start)
        >>> np.round(found.position[0], 3), jb.imagery.Refusal(int(found.status[0])).name
        (Array([17.5, 17.5], dtype=float64), 'MATCHED')
    """
    prepare_jax()
    pairs = Pair(*(jnp.asarray(x, float) for x in (templates, searched, references, starts)))
    count = pairs.template.shape[0]
    dimensions = tuple(x.ndim for x in pairs)
    if dimensions != (3, 3, 2, 2) or {len(x) for x in pairs} != {count} or pairs.start.shape[1] != 6:
        raise ValueError(
            f"arrays of shapes {', '.join(str(x.shape) for x in pairs)}; give (match, height, width),"
            " (match, row, column), (match, 2) and (match, 6)"
        )
    if min(pairs.template.shape[1:]) ** 2 <= UNKNOWNS:
        raise ValueError(f"templates of {pairs.template.shape[1:]} px; a template needs at least 3 x 3 px")
    largest = min(pairs.template.shape[1:]) / 4 if options.max_shift is None else options.max_shift
    chosen = options.max_iterations, options.settled, options.min_correlation, options.max_sigma, largest
    limits, form = Limits(*map(on_device, chosen)), Form(options.parameters, options.interpolation == "bilinear")
    if not is_concrete(pairs):
        return jax.vmap(lambda pair: _differentiable(form, limits, pair))(pairs)
    firsts, many = range(0, max(count, 1), TOGETHER), pairs.template.size > PIXELS_FOR_OPTIMISATION
    parts = [_matched(form, limits, _padded(pairs, first), optimised=many) for first in firsts]
    return jax.tree.map(lambda *x: on_device(np.concatenate(x)[:count]), *parts)


def _padded(pairs: Pair, first: int) -> Pair:
    """A part of constant size, so that one program is used for all."""

    def part(x: Array) -> Array:
        own = np.asarray(x)[first : first + TOGETHER]
        return on_device(np.pad(own, [(0, TOGETHER - len(own))] + [(0, 0)] * (own.ndim - 1)))

    return Pair(*map(part, pairs))


@Compiled
def _matched(form: Form, limits: Limits, pairs: Pair) -> Matches:
    # one window after the other: a batch would iterate all its windows as often as the slowest one
    return lax.map(lambda pair: _chosen(form, limits, pair)[1], pairs)


def residuals(p: Float[Array, "8"], pair: Pair, surface: Array, bilinear: bool) -> Float[Array, " pixel"]:
    """Residuals v = r0 + r1 g(X, Y) - f of all pixels of the template."""
    x, y = _places(p, pair)
    g = spline.bilinear(surface, x, y) if bilinear else spline.value(surface, x, y)
    return p[6] + p[7] * g - pair.template.ravel()


def _from_reference(pair: Pair) -> tuple[Array, Array]:
    """Coordinates of the template's pixels from its reference point."""
    rows, columns = pair.template.shape
    x = jnp.tile(jnp.arange(columns, dtype=float) + 0.5, rows) - pair.reference[0]
    return x, jnp.repeat(jnp.arange(rows, dtype=float) + 0.5, columns) - pair.reference[1]


def _places(p: Array, pair: Pair) -> tuple[Array, Array]:
    """Positions of the template's pixels in the searched window."""
    x, y = _from_reference(pair)
    return p[0] + p[1] * x + p[2] * y, p[3] + p[4] * x + p[5] * y


def normal_equations(p: Array, pair: Pair, surface: Array, bilinear: bool) -> tuple[Array, Array, Array]:
    """Computes N = A^T A, A^T v and v^T v; rows from the derivatives of the interpolant along both coordinates."""
    x, y = _places(p, pair)
    g, gx, gy = _with_slopes(surface, x, y, bilinear)
    u, w = _from_reference(pair)
    gx, gy = p[7] * gx, p[7] * gy
    a = jnp.stack([gx, gx * u, gx * w, gy, gy * u, gy * w, jnp.ones_like(g), g])
    v = p[6] + p[7] * g - pair.template.ravel()
    return a @ a.T, a @ v, v @ v


def _with_slopes(surface: Array, x: Array, y: Array, bilinear: bool) -> tuple[Array, Array, Array]:
    """Grey values with their derivatives along x and y."""
    interpolant, one = spline.bilinear if bilinear else spline.value, jnp.ones_like(x)
    g, gx = jax.jvp(lambda x: interpolant(surface, x, y), (x,), (one,))
    gy = jax.jvp(lambda y: interpolant(surface, x, y), (y,), (one,))[1]
    return lax.optimization_barrier((g, gx, gy))  # else the compiler evaluates them again for each row of equations


def _factor(normals: Array, free: Array) -> tuple[Array, Array, Array]:
    """Cholesky factor of the normal equations with unit diagonal, the scale, and whether all is determined."""
    both = free[:, None] & free[None]
    diagonal = jnp.diagonal(normals)
    good = free & (diagonal > 0)
    scale = jnp.where(good, 1 / jnp.sqrt(jnp.where(good, diagonal, 1.0)), 1.0)
    n = jnp.where(both, normals * scale[:, None] * scale[None], 0.0) + jnp.diag(jnp.where(good, 0.0, 1.0))
    factor = cho_factor(n, lower=True)[0]
    pivots = jnp.diagonal(factor)
    determined = jnp.isfinite(pivots).all() & (jnp.min(jnp.where(free, pivots, 1.0)) ** 2 > FLAT) & (good == free).all()
    return factor, scale, determined


def _solution(bilinear: bool, limits: Limits, pair: Pair, surface: Array, free: Array) -> tuple[_State, Array, Array]:
    """The result of the iteration, the covariance of all parameters and s0."""

    def step(state: _State) -> _State:
        normals, right, _ = normal_equations(state.p, pair, surface, bilinear)
        factor, scale, determined = _factor(normals, free)
        d = -scale * cho_solve((factor, True), scale * jnp.where(free, right, 0.0))
        shift = jnp.maximum(jnp.abs(d[0]), jnp.abs(d[3]))
        d = jnp.where(determined, d * jnp.minimum(1.0, MAX_STEP / jnp.maximum(shift, 1e-30)), 0.0)
        p = state.p + d
        return _State(
            p, jnp.where(determined, shift, jnp.inf), state.iterations + 1, determined & jnp.isfinite(p).all()
        )

    def goes_on(state: _State) -> Array:
        away = jnp.maximum(jnp.abs(state.p[0] - pair.start[0]), jnp.abs(state.p[3] - pair.start[3]))
        going = state.valid & (state.step > limits.settled) & (state.iterations < limits.max_iterations)
        return going & (away <= 2 * limits.max_shift)

    state = _State(_first(pair, surface, bilinear), jnp.asarray(jnp.inf), jnp.asarray(0), jnp.asarray(True))
    state = lax.while_loop(goes_on, step, state)
    normals, _, total = normal_equations(state.p, pair, surface, bilinear)
    factor, scale, determined = _factor(normals, free)
    variance = total / (pair.template.size - jnp.sum(free).astype(float))
    cofactors = scale[:, None] * cho_solve((factor, True), jnp.eye(UNKNOWNS)) * scale[None]
    cofactors = jnp.where(determined & free[:, None] & free[None], cofactors, 0.0)
    return state._replace(valid=state.valid & determined), variance * cofactors, jnp.sqrt(variance)


def _first(pair: Pair, surface: Array, bilinear: bool) -> Array:
    """The start with radiometry by moments: equal means and standard deviations."""
    x, y = _places(jnp.concatenate([pair.start, jnp.array([0.0, 1.0])]), pair)
    g = spline.bilinear(surface, x, y) if bilinear else spline.value(surface, x, y)
    spread = jnp.std(g)
    r1 = jnp.where(spread > 0, jnp.std(pair.template) / jnp.where(spread > 0, spread, 1.0), 1.0)
    return jnp.concatenate([pair.start, jnp.stack([jnp.mean(pair.template) - r1 * jnp.mean(g), r1])])


def _chosen(form: Form, limits: Limits, pair: Pair) -> tuple[Array, Matches]:
    """The free parameters, by the options or the test of the affine ones, and the match with them."""
    surface = pair.searched if form.bilinear else spline.coefficients(pair.searched)
    modes = {"shift": [False], "affine": [True], "tested": [False, True]}[form.parameters]
    shift_only = np.array([True, False, False, True, False, False, True, True])
    free = jnp.asarray(np.stack([np.ones(UNKNOWNS, bool) if affine else shift_only for affine in modes]))

    def solved(free: Array) -> tuple[_State, Array, Matches]:
        state, covariance, s0 = _solution(form.bilinear, limits, pair, surface, free)
        return state, covariance, _result(form.bilinear, limits, pair, surface, (state, covariance, s0))

    states, covariances, found = lax.map(solved, free)
    k = jnp.asarray(0)
    if len(modes) == 2:
        variance = jnp.diagonal(covariances[1])[jnp.array([1, 2, 4, 5])]
        change = (states.p[1, :6] - pair.start)[jnp.array([1, 2, 4, 5])]
        significant = jnp.any(change**2 > SIGNIFICANT**2 * variance)
        affine_good, shift_good = found.status[1] == 0, found.status[0] == 0
        k = jnp.where((affine_good & significant) | (affine_good & ~shift_good), 1, 0)
    return free[k], jax.tree.map(lambda x: x[k], found)


def _result(bilinear: bool, limits: Limits, pair: Pair, surface: Array, solved: tuple[_State, Array, Array]) -> Matches:
    state, covariance, s0 = solved
    p = state.p
    x, y = _places(p, pair)
    f = pair.template.ravel()
    g = (residuals(p, pair, surface, bilinear) + f - p[6]) / jnp.where(p[7] == 0, 1.0, p[7])
    fc, gc = f - jnp.mean(f), g - jnp.mean(g)
    product = jnp.sum(fc * fc) * jnp.sum(gc * gc)
    correlation = jnp.where(product > 0, jnp.sum(fc * gc) / jnp.sqrt(jnp.where(product > 0, product, 1.0)), 0.0)
    covariance = covariance[jnp.array([[0], [3]]), jnp.array([0, 3])]
    return Matches(
        jnp.stack([p[0], p[3]]),
        jnp.stack([p[1], p[2], p[4], p[5]]).reshape(2, 2),
        p[6:],
        covariance,
        s0,
        correlation,
        state.iterations,
        _status(limits, pair, state, (x, y, correlation, covariance)),
    )


def _status(limits: Limits, pair: Pair, state: _State, judged: tuple[Array, ...]) -> Array:
    """The first applicable reason of refusal."""
    x, y, correlation, covariance = judged
    p, (rows, columns) = state.p, pair.searched.shape
    inside: Bool[Array, ""] = (jnp.min(x) >= 0.5) & (jnp.max(x) <= columns - 0.5)
    inside &= (jnp.min(y) >= 0.5) & (jnp.max(y) <= rows - 0.5)
    scale = jnp.sqrt(jnp.abs(p[1] * p[5] - p[2] * p[4]))
    away = jnp.maximum(jnp.abs(p[0] - pair.start[0]), jnp.abs(p[3] - pair.start[3]))
    variance = jnp.maximum(covariance[0, 0], covariance[1, 1])
    reasons = [
        (~state.valid, Refusal.NO_TEXTURE),
        (~(away <= limits.max_shift), Refusal.MOVED_FAR),
        (~(state.step <= limits.settled), Refusal.NOT_CONVERGED),
        (~inside, Refusal.OUTSIDE),
        (~((scale >= SCALE[0]) & (scale <= SCALE[1])), Refusal.SCALE),
        (~(correlation >= limits.min_correlation), Refusal.LOW_CORRELATION),
        (~(variance <= limits.max_sigma**2), Refusal.IMPRECISE),
    ]
    status = jnp.asarray(int(Refusal.MATCHED))
    for refused, reason in reversed(reasons):
        status = jnp.where(refused, int(reason), status)
    return status


def _differentiable(form: Form, limits: Limits, pair: Pair) -> Matches:
    """The match, its position and parameters with the derivatives of the minimum."""
    free, found = jax.tree.map(lax.stop_gradient, _chosen(form, limits, jax.tree.map(lax.stop_gradient, pair)))
    bilinear = form.bilinear

    def half_squares(p: Array, pair: Pair) -> Array:
        surface = pair.searched if bilinear else spline.coefficients(pair.searched)
        return 0.5 * jnp.sum(residuals(p, pair, surface, bilinear) ** 2)

    def newton(p: Array, pair: Pair) -> Array:
        still = jax.tree.map(lax.stop_gradient, pair)
        hessian = jnp.where(free[:, None] & free[None], jax.hessian(half_squares)(p, still), jnp.eye(UNKNOWNS))
        return p - jnp.linalg.solve(hessian, jnp.where(free, jax.grad(half_squares)(p, pair), 0.0))

    a, (r0, r1) = found.affine, found.radiometry
    p = jnp.stack([found.position[0], a[0, 0], a[0, 1], found.position[1], a[1, 0], a[1, 1], r0, r1])
    p = lax.fori_loop(0, NEWTON_STEPS, lambda _, p: newton(p, jax.tree.map(lax.stop_gradient, pair)), p)
    p = newton(lax.stop_gradient(p), pair)
    position, affine = jnp.stack([p[0], p[3]]), jnp.stack([p[1], p[2], p[4], p[5]]).reshape(2, 2)
    return dataclasses.replace(found, position=position, affine=affine, radiometry=p[6:])
