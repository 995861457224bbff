"""Polynomials that correct the coordinates of a strip, and the strip as a sensor with their coefficients.

    v = L^-1 (p - x - T(x, y) C)       p, x: object point and strip coordinates in the system of the strip

The strip runs along x. Its coordinates are divided by half of its length (x) and of its width (y), otherwise the
normal equations of degree 3 lose all digits; conformal polynomials are divided by half of the length in all axes. The
coefficients C are then lengths: the contribution of a term at the end or edge of the strip.

    degree 2              1, x, y, x^2, xy per coordinate            15 coefficients
    degree 3              and x^3, x^2 y                             21
    plan-conformal        dX + i dY = sum (a_k + i b_k)(x + iy)^k    6 or 8, and dZ as above
    conformal in space    degree 2 only                              10
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

from jaxbundle.camera.collinearity import Vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.independent.sensors import whitened

Form = Literal["separate", "plan-conformal", "conformal"]
TERMS = ("1", "x", "y", "xx", "xy", "xxx", "xxy")
COUNT = {2: 5, 3: 7}
NUMBERS = 13  # x, y, z, six of L^-1, x, y and z relative to half of the length, y relative to half of the width


def elements(form: Form, degree: int) -> tuple[str, ...]:
    """Names of the coefficients: coordinate and term, a and b of the powers of x + iy, or a1 to a10."""
    of = {c: tuple(f"{c} {term}" for term in TERMS[: COUNT[degree]]) for c in "XYZ"}
    if form == "separate":
        return (*of["X"], *of["Y"], *of["Z"])
    if form == "plan-conformal":
        return (*(f"{part}{k}" for k in range(degree + 1) for part in "ab"), *of["Z"])
    return tuple(f"a{k + 1}" for k in range(10))


def curbed(form: Form, degree: int) -> dict[str, tuple[str, int]]:
    """Coordinate and degree of the coefficients that allow oscillations of a strip."""
    if form == "separate":
        return {f"{c} {t}": (c, len(t)) for c in "XYZ" for t in TERMS[: COUNT[degree]] if len(t) > 1}
    if form == "plan-conformal":
        plan = {f"{part}{k}": ("XY"[n], k) for k in range(2, degree + 1) for n, part in enumerate("ab")}
        return plan | {f"Z {t}": ("Z", len(t)) for t in TERMS[: COUNT[degree]] if len(t) > 1}
    return {"a8": ("X", 2), "a9": ("Y", 2), "a10": ("Z", 2)}


def correction(form: Form, degree: int, c: tuple[Scalar, ...], at: tuple[Scalar, ...]) -> tuple[Scalar, Scalar, Scalar]:
    """Computes T C at normalised coordinates: x, y, z relative to half of the length, y to half of the width."""
    x, y, z, across = at
    terms = (1.0, x, across, x * x, x * across, x * x * x, x * x * across)[: COUNT[degree]]
    n = len(terms)

    def series(c: tuple[Scalar, ...]) -> Scalar:
        return sum(a * t for a, t in zip(c, terms, strict=True))

    if form == "separate":
        return series(c[:n]), series(c[n : 2 * n]), series(c[2 * n :])
    if form == "plan-conformal":
        dx, dy, re, im = 0.0 * x, 0.0 * x, 1.0, 0.0
        for k in range(degree + 1):
            a, b = c[2 * k], c[2 * k + 1]
            dx, dy = dx + a * re - b * im, dy + a * im + b * re
            re, im = re * x - im * y, re * y + im * x
        return dx, dy, series(c[2 * degree + 2 :])
    a1, a2, a3, a4, a5, a6, a7, a8, a9, a10 = c
    return (
        a1 + a4 * x - a5 * y - a6 * z + a8 * (x * x - y * y - z * z) + 2 * a9 * x * y + 2 * a10 * x * z,
        a2 + a5 * x + a4 * y - a7 * z + 2 * a8 * x * y + a9 * (y * y - x * x - z * z) + 2 * a10 * y * z,
        a3 + a6 * x + a7 * y + a4 * z + 2 * a8 * x * z + 2 * a9 * y * z + a10 * (z * z - x * x - y * y),
    )


@dataclass(frozen=True)
class _Residual:
    """The residual of a strip, as a class so that compiled programs are identified by its fields."""

    form: Form
    degree: int

    def __call__(self, interior: tuple[Scalar, ...], p: Vector, measured: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
        t = correction(self.form, self.degree, interior, measured[9:13])
        x, y, z = (p[k] - measured[k] - t[k] for k in range(3))
        return whitened((x, y, z), measured[3:9])


@cache
def strip_sensor(form: Form, degree: int) -> CameraModel:
    """A strip as a sensor: its interior elements are the coefficients, its exterior orientation is its fixed system."""
    name = f"strip, {form}, degree {degree}" if form != "conformal" else "strip, conformal in space"
    return CameraModel(name, elements(form, degree), _Residual(form, degree), components=3, numbers=NUMBERS)
