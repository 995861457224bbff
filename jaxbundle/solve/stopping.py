"""Stopping rules, by name. The textbook (166) names three; the fourth is modern practice and the default.

angle      |J d| <= tolerance |v|: the angle between the residuals and the tangent plane. Free of units
points     the largest change of a coordinate of an object point < delta
parallax   the largest remaining y-parallax of the stereo pairs no longer falls by more than delta
unknown    the largest change of the named unknowns < delta, each in its own unit
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.given import require_a
from jaxbundle.block.residuals import Observations, observations_of, ray_residuals
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import central_projection, photo_vector
from jaxbundle.geometry import rotation
from jaxbundle.normals.plan.elimination_plan import Order


class StepTaken(NamedTuple):
    """What a rule may look at: the unknowns before and after an accepted step, and (|J d| / |v|)^2.

    J d is taken as what the step changed v by, which it is near the minimum.
    """

    before: Unknowns
    after: Unknowns
    angle_squared: Float[Array, ""]
    observations: Observations


class AbstractStoppingRule(eqx.Module):
    """A rule measures an accepted step; the solve ends where the measure falls to the limit or below."""

    name: ClassVar[str]
    limit: eqx.AbstractVar[float]

    @abc.abstractmethod
    def measure(self, step: StepTaken) -> Float[Array, ""]:
        """The number that is held against the limit."""

    def arranged(self, order: Order) -> "AbstractStoppingRule":
        """The rule for unknowns in another order than the block's."""
        return self


class AngleRule(AbstractStoppingRule):
    """|J d| <= limit |v|, after Boerlin & Grussenmeyer (2013): |J d| is what a step still moves the residuals."""

    name: ClassVar[str] = "angle"
    limit: float = 1e-8

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        return jnp.sqrt(jnp.maximum(step.angle_squared, 0.0))


class PointRule(AbstractStoppingRule):
    """Largest change of a coordinate of an object point, object unit."""

    limit: float
    name: ClassVar[str] = "points"

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        return jnp.max(jnp.abs(step.after.points - step.before.points))


class ParallaxRule(AbstractStoppingRule):
    """Fall of the largest y-parallax of all stereo pairs, in units of the principal distance."""

    limit: float
    first_ray: Int[Array, " pair"]
    second_ray: Int[Array, " pair"]
    rays: Observations
    name: ClassVar[str] = "parallax"

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        before = jnp.max(jnp.abs(self.parallax(step.before)))
        return before - jnp.max(jnp.abs(self.parallax(step.after)))

    def arranged(self, order: Order) -> "ParallaxRule":
        rays = self.rays
        moved = (
            jnp.asarray(order.image, jnp.int32)[rays.ray_image],
            jnp.asarray(order.point, jnp.int32)[rays.ray_point],
            jnp.zeros(order.images, jnp.int32)
            .at[order.image]
            .set(jnp.asarray(order.camera, jnp.int32)[rays.image_camera]),
        )
        return eqx.tree_at(lambda r: (r.rays.ray_image, r.rays.ray_point, r.rays.image_camera), self, moved)

    def parallax(self, unknowns: Unknowns) -> Float[Array, " pair"]:
        """y-parallax y' - y'' of each pair, its photographs turned into the normal case along their base."""
        directions, centres = measured_directions(unknowns, self.rays)
        u, w = directions[:, self.first_ray], directions[:, self.second_ray]
        base = centres[:, self.second_ray] - centres[:, self.first_ray]
        base = base / jnp.sqrt(jnp.sum(base**2, 0))
        mean = u + w
        depth = mean - base * jnp.sum(mean * base, 0)  # normal case: depth at right angles to the base
        depth = depth / jnp.sqrt(jnp.sum(depth**2, 0))
        across = jnp.cross(depth, base, axis=0)
        return jnp.sum(u * across, 0) / jnp.sum(u * depth, 0) - jnp.sum(w * across, 0) / jnp.sum(w * depth, 0)


class UnknownRule(AbstractStoppingRule):
    """Largest change of the chosen unknowns, each in its own unit (angles in radians)."""

    limit: float
    exterior: Bool[Array, "6 image"]
    interior: Bool[Array, "element camera"]
    points: Bool[Array, "3 point"]
    name: ClassVar[str] = "unknown"

    def arranged(self, order: Order) -> "UnknownRule":
        masks = (
            jnp.zeros((6, order.images), bool).at[:, order.image].set(self.exterior),
            jnp.zeros((self.interior.shape[0], order.cameras), bool).at[:, order.camera].set(self.interior),
            jnp.zeros((3, order.points), bool).at[:, order.point].set(self.points),
        )
        return UnknownRule(self.limit, *masks)

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        system = step.observations.system
        old, new = (jnp.stack(system.angles_from_rotation(tuple(u.rotation))) for u in (step.before, step.after))
        turned = jnp.arctan2(jnp.sin(new - old), jnp.cos(new - old))
        exterior = jnp.concatenate([step.after.centre - step.before.centre, turned])
        changes = (
            (exterior, self.exterior),
            (step.after.interior - step.before.interior, self.interior),
            (step.after.points - step.before.points, self.points),
        )
        return jnp.max(jnp.stack([jnp.max(jnp.where(chosen, jnp.abs(change), 0.0)) for change, chosen in changes]))


def measured_directions(
    unknowns: Unknowns, observations: Observations
) -> tuple[Float[Array, "3 ray"], Float[Array, "3 ray"]]:
    """Directions of the measured image points in the object system, and their projection centres.

    The measured direction is the computed one less the residual at image scale: exact for models that correct the
    measurement, of first order in the residual for those that distort the projection.
    """
    image = observations.ray_image
    turn, centre = tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image])
    interior = unknowns.interior[:, observations.image_camera[image]]
    x, y = central_projection(photo_vector(turn, centre, tuple(unknowns.points[:, observations.ray_point])), 1.0)
    elements = observations.model.elements
    scale = 1 / interior[elements.index("principal_distance")] if "principal_distance" in elements else 1.0
    if "pixel_size" in elements:
        scale = scale * interior[elements.index("pixel_size")]
    v = ray_residuals(unknowns, observations) * scale
    photo = x - v[0], y - v[1], -jnp.ones_like(x)
    return jnp.stack(rotation.apply(turn, photo)), jnp.stack(centre)


def parallax_rule(block: Block, delta: float) -> ParallaxRule:
    """The rule for all pairs of successive images of each point."""
    require_a(Block, block, "parallax_rule")
    structure = block.structure
    order = np.lexsort((structure.ray_image, structure.ray_point))
    image, point = structure.ray_image[order], structure.ray_point[order]
    same = (point[1:] == point[:-1]) & (image[1:] != image[:-1])  # a point measured twice on an image has no base there
    first, second = jnp.asarray(order[:-1][same]), jnp.asarray(order[1:][same])
    return ParallaxRule(delta, first, second, observations_of(block))


def unknown_rule(block: Block, delta: float, *names: tuple[str, str]) -> UnknownRule:
    """The rule for unknowns named ("image", "X0"), ("camera", "K1") or ("point", "Z"); without names, for all.

    Raises: ValueError naming what is not in the block.
    """
    require_a(Block, block, "unknown_rule")
    structure = block.structure
    exterior = np.full((6, len(structure.image_names)), not names)
    interior = np.full((block.interior.elements.shape[1], len(structure.cameras)), not names)
    points = np.full((3, len(structure.point_names)), not names)
    for who, element in names:
        if not _choose(structure, who, element, exterior, interior, points):
            raise ValueError(f"no unknown {element} of {who} in the block; name an image, a camera or a point of it")
    return UnknownRule(delta, jnp.asarray(exterior), jnp.asarray(interior), jnp.asarray(points))


def _choose(structure: Structure, who: str, element: str, exterior, interior, points) -> bool:
    cameras = {camera.name: k for k, camera in enumerate(structure.cameras)}
    if who in structure.image_names and element in structure.exterior_elements:
        exterior[structure.exterior_elements.index(element), structure.image_names.index(who)] = True
    elif who in cameras and element in structure.cameras[cameras[who]].model.elements:
        interior[structure.cameras[cameras[who]].model.elements.index(element), cameras[who]] = True
    elif who in structure.point_names and element in ("X", "Y", "Z"):
        points["XYZ".index(element), structure.point_names.index(who)] = True
    else:
        return False
    return True
