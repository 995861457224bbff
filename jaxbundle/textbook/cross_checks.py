"""Comparing the partial derivatives and the matrix of Text 000 with automatic derivatives of the image equation.

Each formula is compared with three derivatives of equation (161) for many random rays:

    forward, reverse    automatic differentiation
    complex             Im F(u + i h) / h with h = 1e-30: without a difference, so it is exact up to rounding
                        (Squire & Trapp 1998); the image equation is analytic in its nine unknowns

The criterion is the maximum deviation, in units of the maximum displacement of the image point by an unknown of the
kind:

    d / |Z*|    by a shift of one unit of length      d^2 / f    by a rotation of one radian      d^2 = f^2 + x^2 + y^2

These are the largest singular values of the two derivatives. They never vanish, so a zero of a partial derivative does
not cause a false alarm, and a wrong sign gives a deviation of the order of one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from textwrap import fill
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.camera.collinearity import central_projection, collinearity, photo_vector
from jaxbundle.geometry.rotation import IDENTITY, Rotation, apply, from_alpha_omega_kappa, product, transpose
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.textbook.partials import (
    FORMULAS,
    MATRIX_ELEMENTS,
    NAMES,
    UNKNOWNS,
    Partials,
    printed_matrix,
    printed_partials,
    regular_partials,
)

THRESHOLD = 1e-12  # thousands of rounding errors; a misprint deviates by the order of one
STEP = 1e-30  # its square is negligible relative to all unknowns and does not underflow
WIDTH = 100
METHODS = ("forward", "reverse", "complex")

Formulas = Callable[..., Partials]
Matrix = Callable[..., Rotation]


class Rays(NamedTuple):
    """Random rays: the nine unknowns in the order of (162), and the principal distance."""

    unknowns: Float[Array, "9 ray"]
    principal_distance: Float[Array, " ray"]


@dataclass(frozen=True)
class Comparison:
    """Maximum deviations of 18 formulas from the three derivatives, over one set of rays.

    `opposite` is the maximum deviation of the formulas with reversed signs.
    """

    deviations: Float[np.ndarray, "3 18"]
    opposite: Float[np.ndarray, "3 18"]

    @property
    def worst(self) -> np.ndarray:
        """The maximum deviation of each formula; infinite if a formula has no value."""
        return self.deviations.max(axis=0)

    @property
    def holds(self) -> np.ndarray:
        """Mask of the correct formulas."""
        return self.worst <= THRESHOLD

    @property
    def wrong_sign(self) -> np.ndarray:
        """Mask of the formulas that are correct only with the opposite sign."""
        return ~self.holds & (self.opposite.max(axis=0) <= THRESHOLD)


@dataclass(frozen=True)
class MatrixComparison:
    """The printed matrix (164): deviation of its elements from the corrected one, and max |R^T R - I| of both."""

    deviations: Float[np.ndarray, " 9"]
    printed_defect: float
    corrected_defect: float

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the misprinted elements."""
        return tuple(name for (name, *_), d in zip(MATRIX_ELEMENTS, self.deviations, strict=True) if d > THRESHOLD)


@dataclass(frozen=True)
class CrossCheck:
    """The verdict on 18 formulas, printed ones or those of the user, and on the printed matrix.

    For ordinary rays omega is within +-85 deg; for singular ones it is at or close to +-90 deg.

    Example:
        >>> jb.textbook.crosscheck(draws=100).draws
        100
    """

    title: str
    draws: int
    ordinary: Comparison
    singular: Comparison
    with_printed_matrix: Comparison
    regular: Comparison
    regular_singular: Comparison
    matrix: MatrixComparison

    @property
    def passed(self) -> bool:
        """Whether the formulas are correct away from omega = +-90 deg, and the form without 0/0 everywhere."""
        return all(comparison.holds.all() for comparison in (self.ordinary, self.regular, self.regular_singular))

    def table(self) -> str:
        """All deviations: one line per partial derivative, then one line per element of the matrix."""
        return "\n".join([*_partials_table(self), "", *_matrix_table(self.matrix)])

    def verdict(self) -> str:
        """The correct and the wrong formulas, and corrections."""
        lines = [*_verdict_on_formulas(self), *_verdict_on_matrix(self)]
        return "\n".join(fill(line, WIDTH, subsequent_indent="  ") for line in lines)


def crosscheck(partials: Formulas | None = None, *, draws: int = 100_000, seed: int = 0) -> CrossCheck:
    """Compares the printed partials (163), or those of the user, with derivatives of the image equation.

    `partials(rotation, angles, projection_centre, object_point, principal_distance)` returns the 18 partials
    A1 ... A9, B1 ... B9, as `printed_partials` does: `rotation` = (a1, a2, a3, b1, b2, b3, c1, c2, c3), `angles` =
    (alpha, omega, kappa), two points, f. Each of these scalars is an array with one element per ray.

    Example:
        >>> jb.textbook.crosscheck(draws=100).draws
        100
    """
    prepare_jax()
    if draws < 1:
        raise ValueError(f"draws is {draws}; a comparison needs at least 1 ray")
    formulas, title = (printed_partials, "as printed") if partials is None else (partials, "as given")
    rng = np.random.default_rng(seed)
    ordinary = _draw(rng, _ordinary_omega(rng, draws))
    singular = _draw(rng, _singular_omega(rng, draws))
    ordinary_derivatives = _derivatives(ordinary, from_alpha_omega_kappa)
    singular_derivatives = _derivatives(singular, from_alpha_omega_kappa)
    return CrossCheck(
        title,
        draws,
        _compare(formulas, from_alpha_omega_kappa, ordinary, ordinary_derivatives),
        _compare(formulas, from_alpha_omega_kappa, singular, singular_derivatives),
        _compare(formulas, printed_matrix, ordinary, _derivatives(ordinary, printed_matrix)),
        _compare(regular_partials, from_alpha_omega_kappa, ordinary, ordinary_derivatives),
        _compare(regular_partials, from_alpha_omega_kappa, singular, singular_derivatives),
        _compare_matrices(ordinary.unknowns[3:6]),
    )


def orthonormality_defect(rotation: Rotation) -> Float[Array, "..."]:
    """The defect max |R^T R - I|, which is zero for a rotation.

    Example:
        >>> float(jb.textbook.orthonormality_defect((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)))
        0.0
    """
    gram = product(transpose(rotation), rotation)
    return jnp.max(jnp.stack([jnp.abs(g - i) for g, i in zip(gram, IDENTITY, strict=True)]), axis=0)


def _ordinary_omega(rng: np.random.Generator, draws: int) -> np.ndarray:
    return np.radians(rng.uniform(-85.0, 85.0, draws))


def _singular_omega(rng: np.random.Generator, draws: int) -> np.ndarray:
    """Angles near +-90 deg: each fourth exactly, the others with offsets of 1e-17 to 0.1 rad on both sides."""
    offset = 10 ** rng.uniform(-17, -1, draws) * rng.choice([-1.0, 1.0], draws)
    offset[::4] = 0.0
    return (np.pi / 2 + offset) * rng.choice([-1.0, 1.0], draws)


def _draw(rng: np.random.Generator, omega: np.ndarray) -> Rays:
    """Terrain points in front of cameras of any heading, up to 45 deg off axis in x and in y."""
    draws = len(omega)
    alpha, kappa = rng.uniform(-np.pi, np.pi, (2, draws))
    centre = rng.uniform(-1000.0, 1000.0, (3, draws))
    principal_distance = 10 ** rng.uniform(1, 3, draws)
    depth = 10 ** rng.uniform(0, 4, draws)
    p = depth * np.stack([*rng.uniform(-1.0, 1.0, (2, draws)), np.full(draws, -1.0)])
    angles = jnp.asarray(alpha), jnp.asarray(omega), jnp.asarray(kappa)
    ray = apply(from_alpha_omega_kappa(*angles), (jnp.asarray(p[0]), jnp.asarray(p[1]), jnp.asarray(p[2])))
    return Rays(jnp.concatenate([centre, jnp.stack(angles), centre + jnp.stack(ray)]), jnp.asarray(principal_distance))


def _complex_step(function: Callable) -> Callable:
    """The Jacobian of a real analytic function of a vector, in the form of `jax.jacfwd`."""

    def jacobian(unknowns: Float[Array, " n"], *arguments: Array) -> Float[Array, "m n"]:
        steps = unknowns.astype(complex)[None] + 1j * STEP * jnp.eye(len(unknowns), dtype=complex)
        others = [argument.astype(complex) for argument in arguments]
        return jax.vmap(lambda shifted: function(shifted, *others), out_axes=-1)(steps).imag / STEP

    return jacobian


@partial(jax.jit, static_argnames="matrix")
def _derivatives(rays: Rays, matrix: Matrix) -> Float[Array, "3 2 9 ray"]:
    """The derivatives d(x, y) / d(unknowns) of the image equation by the three methods."""

    def image_point(unknowns: Array, principal_distance: Array) -> Array:
        x0, y0, z0, alpha, omega, kappa, x, y, z = unknowns
        return jnp.stack(collinearity(matrix(alpha, omega, kappa), (x0, y0, z0), (x, y, z), principal_distance))

    jacobians = jax.jacfwd(image_point), jax.jacrev(image_point), _complex_step(image_point)
    return jnp.stack([jax.vmap(jacobian, in_axes=-1, out_axes=-1)(*rays) for jacobian in jacobians])


def _compare(formulas: Formulas, matrix: Matrix, rays: Rays, derivatives: Float[Array, "3 2 9 ray"]) -> Comparison:
    x0, y0, z0, alpha, omega, kappa, x, y, z = rays.unknowns
    rotation, centre, point = matrix(alpha, omega, kappa), (x0, y0, z0), (x, y, z)
    with np.errstate(all="ignore"):  # some formulas are 0/0 at omega = +-90 deg, which must be detected
        values = formulas(rotation, (alpha, omega, kappa), centre, point, rays.principal_distance)
    if len(values) != len(NAMES):
        raise ValueError(f"the partials are {len(values)} values; return 18, A1 ... A9 and then B1 ... B9")
    closed = jnp.stack([jnp.broadcast_to(value, x.shape) for value in values])
    p = photo_vector(rotation, centre, point)
    return Comparison(*map(np.asarray, _largest(closed, derivatives, jnp.stack(p), rays.principal_distance)))


@jax.jit
def _largest(
    closed: Float[Array, "18 ray"],
    derivatives: Float[Array, "3 2 9 ray"],
    p: Float[Array, "3 ray"],
    principal_distance: Float[Array, " ray"],
) -> tuple[Float[Array, "3 18"], Float[Array, "3 18"]]:
    """Maximum deviation over the rays, with the given and with the opposite sign, in the units of this module.

    With the printed matrix some points are behind the camera or far to its side: only rays within 60 deg of the axis
        count.
    """
    x, y = central_projection((p[0], p[1], p[2]), principal_distance)
    d2 = principal_distance**2 + x**2 + y**2
    shift, turn = jnp.sqrt(d2) / jnp.abs(p[2]), d2 / principal_distance
    unit = jnp.stack([shift] * 3 + [turn] * 3 + [shift] * 3)
    in_view = (p[2] < 0) & (d2 < 4 * principal_distance**2)
    derivatives = derivatives.reshape(len(METHODS), len(NAMES), -1)

    def largest(difference: Float[Array, "3 18 ray"]) -> Float[Array, "3 18"]:
        relative = jnp.abs(difference) / jnp.concatenate([unit, unit])[None]
        relative = jnp.where(jnp.isnan(relative), jnp.inf, relative)  # on a CPU, XLA's maximum ignores NaN
        return jnp.max(jnp.where(in_view, relative, 0.0), axis=-1)

    return largest(closed[None] - derivatives), largest(closed[None] + derivatives)


def _compare_matrices(angles: Float[Array, "3 ray"]) -> MatrixComparison:
    printed, corrected = printed_matrix(*angles), from_alpha_omega_kappa(*angles)
    deviations = [float(jnp.max(jnp.abs(p - c))) for p, c in zip(printed, corrected, strict=True)]
    defects = [float(jnp.max(orthonormality_defect(matrix))) for matrix in (printed, corrected)]
    return MatrixComparison(np.array(deviations), *defects)


def _label(k: int | np.integer) -> str:
    return f"{NAMES[k]} d{'x' if k < 9 else 'y'}/d{UNKNOWNS[k % 9]}"


def _partials_table(check: CrossCheck) -> list[str]:
    columns = (
        *((method, "", deviations) for method, deviations in zip(METHODS, check.ordinary.deviations, strict=True)),
        (check.title, "at +-90 deg", check.singular.worst),
        ("with (164)", "as printed", check.with_printed_matrix.worst),
        ("without 0/0", "elsewhere", check.regular.worst),
        ("without 0/0", "at +-90 deg", check.regular_singular.worst),
    )
    rows = [f"{_label(k):12}" + "".join(f"{column[2][k]:12.1e}" for column in columns) for k in range(len(NAMES))]
    return [
        f"Partials (163), {check.draws} random rays: maximum deviation, 1 = maximum displacement of an image point",
        f"{'':12}{check.title + ', against':^36}" + "".join(f"{column[0]:>12}" for column in columns[3:]),
        f"{'':12}" + "".join(f"{column[0] if k < 3 else column[1]:>12}" for k, column in enumerate(columns)),
        *rows,
        "at +-90 deg: omega = +-90 deg or close to it, worst of the three; elsewhere: omega within +-85 deg",
    ]


def _matrix_table(matrix: MatrixComparison) -> list[str]:
    rows = [
        f"{name}  {printed:38}{deviation:12.1e}  {corrected if name in matrix.wrong else ''}".rstrip()
        for (name, printed, corrected), deviation in zip(MATRIX_ELEMENTS, matrix.deviations, strict=True)
    ]
    return [
        "Matrix (164), a w k = alpha omega kappa: maximum deviation from the corrected one",
        f"{'':4}{'as printed':38}{'deviation':>12}  corrected",
        *rows,
        f"max |R^T R - I|: as printed {matrix.printed_defect:.2g}, corrected {matrix.corrected_defect:.1e}",
    ]


def _verdict_on_formulas(check: CrossCheck) -> list[str]:
    ordinary, singular = check.ordinary, check.singular
    count = int(ordinary.holds.sum())
    held = "All 18 partials are correct" if count == 18 else f"{count} of the 18 partials are correct"
    lines = [f"{held} {check.title}, with the corrected matrix (threshold {THRESHOLD:.0e})."]
    for k in np.flatnonzero(~ordinary.holds):
        sign = "has the opposite sign" if ordinary.wrong_sign[k] else f"deviates by {ordinary.worst[k]:.1e}"
        lines.append(f"  {_label(k)} {sign}; correct: {NAMES[k]} = {FORMULAS[k]}")
    lost = np.flatnonzero(ordinary.holds & ~singular.holds)
    if lost.size:
        lines.append(f"At omega = +-90 deg, or close to it, {_names(lost)} lose their digits (0/0); there use")
        lines += [f"  {NAMES[k]} = {FORMULAS[k]}" for k in lost]
    if (check.regular.holds & check.regular_singular.holds).all():
        lines.append("The form without 0/0 is correct in all attitudes, including omega = +-90 deg.")
    return lines


def _verdict_on_matrix(check: CrossCheck) -> list[str]:
    matrix, holds = check.matrix, check.with_printed_matrix.holds
    lines = [
        f"The matrix (164) as printed is not a rotation, max |R^T R - I| = {matrix.printed_defect:.2g}; "
        f"{len(matrix.wrong)} elements are wrong. Correct:"
    ]
    lines += [f"  {name} = {corrected}" for name, _, corrected in MATRIX_ELEMENTS if name in matrix.wrong]
    lines.append(f"With the matrix as printed {_names(np.flatnonzero(~holds))} are not correct.")
    return lines


def _names(indices: np.ndarray) -> str:
    return ", ".join(NAMES[k] for k in indices)
