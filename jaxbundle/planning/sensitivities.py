"""Sensitivity of an adjusted coordinate to all observations, by one reverse pass through the adjustment.

    dx / d(each measured value, control coordinate, calibration value)

by the implicit function theorem at the minimum, with all second derivatives: exact, not the linear model of the last
iteration. The sum of squares of derivative times sigma over all observations is the variance of x.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.findings import Subject
from jaxbundle.block.given import require_a
from jaxbundle.numerics.compilation import QUICKLY, RAYS_FOR_OPTIMISATION
from jaxbundle.solve.adjust import adjust


class Effect(NamedTuple):
    """Effect of one value on the function.

    Example:
        >>> found = jb.planning.sensitivity(block, lambda b: b.object_points[4, 2])
        >>> found.effects[0].unit
        'px'
    """

    subject: Subject
    """Table, names and component: ("rays", ("image", "point"), "x"), ("cameras", ("scan",), "principal_distance")."""
    derivative: float
    """Unit of the function per unit of the value; radians for angles."""
    unit: str
    """The value."""
    sigma: float
    """Standard deviation of the value; 0 if fixed."""

    @property
    def effect(self) -> float:
        """Change of the function for an error of one sigma; 0 if fixed."""
        return self.derivative * self.sigma


class Sensitivity(NamedTuple):
    """The effects of all input values, the largest first.

    Example:
        >>> found = jb.planning.sensitivity(block, lambda b: b.object_points[4, 2])
        >>> len(found.effects) > 10
        True
    """

    value: float
    effects: tuple[Effect, ...]
    """Observations in decreasing order of the effect of one sigma."""
    held: tuple[Effect, ...]
    """Fixed control coordinates and interior elements in decreasing order of the derivative."""

    @property
    def standard_deviation(self) -> float:
        """A-priori standard deviation of the function: the square root of the sum of squared effects."""
        return float(np.sqrt(sum(e.effect**2 for e in self.effects)))


def sensitivity(block: Block, function: Callable[[Block], Array]) -> Sensitivity:
    """Computes derivatives of a function of the adjusted block with respect to all input values.

    Args:
        block: the block; it is adjusted.
        function: a function of the adjusted block with one number as result, such as `lambda b: b.object_points[350,
            2]`.

    Returns: observations and fixed values with their derivatives. Those of a function that does not depend on the
    block, or of an adjustment that has not converged, are 0 or NaN.

    Raises: TypeError for an object that is not a Block; ValueError for a function with more than one number.

    Example:
        >>> found = jb.planning.sensitivity(block, lambda b: b.object_points[4, 2])
        >>> found.effects[0].subject.table
        'rays'
    """
    require_a(Block, block, "planning.sensitivity")
    block = with_datum(block)
    shape = jax.eval_shape(lambda b: jnp.asarray(function(b)), block).shape
    if shape != ():
        raise ValueError(f"the function returns an array of shape {shape}; return one number, such as one coordinate")

    def adjusted(block: Block) -> Array:
        return jnp.asarray(function(adjust(block, precision=False).block))

    options = QUICKLY if len(block.structure.ray_image) < RAYS_FOR_OPTIMISATION else {}
    value, derivatives = jax.jit(jax.value_and_grad(adjusted), compiler_options=options)(block)
    observed = [*_rays(block, derivatives), *_groups(block, derivatives)]
    observed.sort(key=lambda e: -abs(e.effect))
    held = [*_fixed_points(block, derivatives), *_interior(block, derivatives)]
    held.sort(key=lambda e: -abs(e.derivative))
    return Sensitivity(float(value), tuple(observed), tuple(held))


def _rays(block: Block, derivatives: Block) -> list[Effect]:
    s = block.structure
    unit = s.cameras[0].image_unit
    numbers, sigmas = np.asarray(derivatives.rays.coordinates), np.asarray(block.rays.sigmas)
    axes = ("x", "y") if numbers.shape[1] == 2 else tuple(str(k + 1) for k in range(numbers.shape[1]))
    return [
        Effect(Subject("rays", (s.image_names[image], s.point_names[point]), axis), float(d), unit, float(sigma))
        for image, point, row, of_row in zip(s.ray_image, s.ray_point, numbers, sigmas, strict=True)
        for axis, d, sigma in zip(axes, row, of_row, strict=False)
        if d != 0
    ]


def _groups(block: Block, derivatives: Block) -> list[Effect]:
    s = block.structure
    names = {
        "point": s.point_names,
        "image": s.image_names,
        "camera": tuple(camera.name for camera in s.cameras),
    }
    found = []
    for group, derivative in zip(block.groups, derivatives.groups, strict=True):
        kind = group.structure.kind
        unit = "rad" if kind.angles else s.object_unit
        values, sigmas = np.asarray(derivative.values), np.asarray(group.sigmas)
        for member, row in enumerate(group.structure.indices.tolist()):
            who = tuple(names[t][k] for t, k in zip(kind.touches, row, strict=True) if t in names)
            if not who:
                who = tuple(s.parameters[k].name for k in row)
            for c, component in enumerate(kind.components):
                if group.structure.observed[member, c]:
                    subject = Subject(kind.table, who, component)
                    found.append(Effect(subject, float(values[member, c]), unit, float(sigmas[member, c])))
    return found


def _fixed_points(block: Block, derivatives: Block) -> list[Effect]:
    s, numbers = block.structure, np.asarray(derivatives.object_points)
    return [
        Effect(
            Subject("control", (s.point_names[point],), "XYZ"[axis]), float(numbers[point, axis]), s.object_unit, 0.0
        )
        for point, axis in np.argwhere(~s.point_free).tolist()
    ]


def _interior(block: Block, derivatives: Block) -> list[Effect]:
    s, numbers = block.structure, np.asarray(derivatives.interior.elements)
    return [
        Effect(Subject("cameras", (camera.name,), element), float(numbers[c, k]), camera.unit_of(element), 0.0)
        for c, camera in enumerate(s.cameras)
        for k, element in enumerate(camera.model.elements)
        if not s.interior_free[c, k] and element not in ("pixel_size", "y_axis", "grid_base")
    ]
