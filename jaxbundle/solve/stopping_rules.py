"""Stopping rules, by name. Text 000 (166) has three; the fourth is modern practice and the default.

angle      |J d| <= tolerance |v|: the angle between the residuals and the tangent plane. Free of units
points     the maximum change of a coordinate of an object point < delta
parallax   the maximum remaining y-parallax of the stereo pairs decreases by less than delta unknown    the maximum
change of the named unknowns < delta, each in its unit
"""

import abc
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.residuals import Observations, observations_of, ray_residuals
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.camera.collinearity import central_projection, photo_vector
from jaxbundle.geometry import rotation
from jaxbundle.normals.plan.elimination_plan import Order


class StepTaken(NamedTuple):
    """Input of a rule: the unknowns before and after an accepted step, and (|J d| / |v|)^2.

    J d is the change of v by the step, which is exact only near the minimum.
    """

    before: Unknowns
    after: Unknowns
    angle_squared: Float[Array, ""]
    observations: Observations


class AbstractStoppingRule(eqx.Module):
    """Base class of stopping rules: the solve ends when the measure of an accepted step is at most the limit.

    A rule does not depend on a block. `of` adds the required data of a block before a solve.
    """

    name: ClassVar[str]
    limit: eqx.AbstractVar[float]

    def of(self, block: Block) -> "AbstractStoppingRule":
        """The rule with the required data of one block."""
        return self

    @abc.abstractmethod
    def measure(self, step: StepTaken) -> Float[Array, ""]:
        """The number that is compared with the limit."""

    def arranged(self, order: Order) -> "AbstractStoppingRule":
        """The rule for unknowns in elimination order."""
        return self


class AngleRule(AbstractStoppingRule):
    """Rule |J d| <= limit |v| (Boerlin & Grussenmeyer 2013); |J d| is the change of the residuals by the step.

    Example:
        >>> jb.adjust(block, stop=jb.stopping.AngleRule(1e-10)).status.name
        'CONVERGED'
    """

    name: ClassVar[str] = "angle"
    limit: float = eqx.field(static=True, converter=float, default=1e-8)

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        return jnp.sqrt(jnp.maximum(step.angle_squared, 0.0))


class PointRule(AbstractStoppingRule):
    """Rule for the maximum change of a coordinate of an object point, object unit.

    Example:
        >>> jb.stopping.PointRule(0.001).limit
        0.001
    """

    limit: float = eqx.field(static=True, converter=float)
    name: ClassVar[str] = "points"

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        return jnp.max(jnp.abs(step.after.points - step.before.points))


class StereoPairs(eqx.Module):
    """Indices of rays of the same point on two images."""

    first_ray: Int[Array, " pair"]
    second_ray: Int[Array, " pair"]
    rays: Observations


class ParallaxRule(AbstractStoppingRule):
    """Rule for the decrease of the maximum y-parallax of all stereo pairs, in units of the principal distance.

    The pairs are successive images of each point; `of` finds their rays in a block.
    """

    limit: float = eqx.field(static=True, converter=float)
    pairs: StereoPairs | None = None
    name: ClassVar[str] = "parallax"

    def of(self, block: Block) -> "ParallaxRule":
        structure = block.structure
        order = np.lexsort((structure.ray_image, structure.ray_point))
        image, point = structure.ray_image[order], structure.ray_point[order]
        # two rays of a point on the same image have no base
        same = (point[1:] == point[:-1]) & (image[1:] != image[:-1])
        first, second = jnp.asarray(order[:-1][same]), jnp.asarray(order[1:][same])
        return ParallaxRule(self.limit, StereoPairs(first, second, observations_of(block)))

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        before = jnp.max(jnp.abs(self.parallax(step.before)))
        return before - jnp.max(jnp.abs(self.parallax(step.after)))

    def arranged(self, order: Order) -> "ParallaxRule":
        assert self.pairs is not None
        rays = self.pairs.rays
        moved = (
            jnp.asarray(order.image, jnp.int32)[rays.ray_image],
            jnp.asarray(order.point, jnp.int32)[rays.ray_point],
            jnp.zeros(order.images, jnp.int32)
            .at[order.image]
            .set(jnp.asarray(order.camera, jnp.int32)[rays.image_camera]),
        )
        where = eqx.tree_at(lambda o: (o.ray_image, o.ray_point, o.image_camera), rays, moved)
        return eqx.tree_at(lambda r: r.pairs.rays, self, where)

    def parallax(self, unknowns: Unknowns) -> Float[Array, " pair"]:
        """y-parallax y' - y'' of each pair, with photographs rotated to the normal case along their base."""
        assert self.pairs is not None, "a rule needs the rays of one block: call rule.of(block)"
        first, second = self.pairs.first_ray, self.pairs.second_ray
        directions, centres = measured_directions(unknowns, self.pairs.rays)
        u, w = directions[:, first], directions[:, second]
        base = centres[:, second] - centres[:, first]
        base = base / jnp.sqrt(jnp.sum(base**2, 0, keepdims=True))
        mean = u + w
        depth = mean - base * jnp.sum(mean * base, 0, keepdims=True)  # normal case: depth orthogonal to the base
        depth = depth / jnp.sqrt(jnp.sum(depth**2, 0, keepdims=True))
        across = jnp.cross(depth, base, axis=0)
        return jnp.sum(u * across, 0) / jnp.sum(u * depth, 0) - jnp.sum(w * across, 0) / jnp.sum(w * depth, 0)


class ChosenUnknowns(eqx.Module):
    """Masks of the unknowns of a rule."""

    exterior: Bool[Array, "6 image"]
    interior: Bool[Array, "element camera"]
    points: Bool[Array, "3 point"]


class UnknownRule(AbstractStoppingRule):
    """Rule for the maximum change of the unknowns `names`, or of all, each in its unit (angles in radians).

    If a block no longer has some of them, such as a point without rays, the others are used.
    """

    limit: float = eqx.field(static=True, converter=float)
    names: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())
    chosen: ChosenUnknowns | None = None
    name: ClassVar[str] = "unknown"

    def of(self, block: Block) -> "UnknownRule":
        structure = block.structure
        exterior = np.full((6, len(structure.image_names)), not self.names)
        interior = np.full((block.interior.elements.shape[1], len(structure.cameras)), not self.names)
        points = np.full((3, len(structure.point_names)), not self.names)
        there = [_choose(structure, who, element, exterior, interior, points) for who, element in self.names]
        if self.names and not any(there):
            raise _unknown_name(*self.names[0])
        return UnknownRule(self.limit, (), ChosenUnknowns(*map(jnp.asarray, (exterior, interior, points))))

    def arranged(self, order: Order) -> "UnknownRule":
        assert self.chosen is not None
        masks = (
            jnp.zeros((6, order.images), bool).at[:, order.image].set(self.chosen.exterior),
            jnp.zeros((self.chosen.interior.shape[0], order.cameras), bool)
            .at[:, order.camera]
            .set(self.chosen.interior),
            jnp.zeros((3, order.points), bool).at[:, order.point].set(self.chosen.points),
        )
        return UnknownRule(self.limit, (), ChosenUnknowns(*masks))

    def measure(self, step: StepTaken) -> Float[Array, ""]:
        assert self.chosen is not None, "a rule needs the unknowns of one block: call rule.of(block)"
        system = step.observations.system
        old, new = (jnp.stack(system.angles_from_rotation(tuple(u.rotation))) for u in (step.before, step.after))
        turned = jnp.arctan2(jnp.sin(new - old), jnp.cos(new - old))
        exterior = jnp.concatenate([step.after.centre - step.before.centre, turned])
        changes = (
            (exterior, self.chosen.exterior),
            (step.after.interior - step.before.interior, self.chosen.interior),
            (step.after.points - step.before.points, self.chosen.points),
        )
        return jnp.max(jnp.stack([jnp.max(jnp.where(chosen, jnp.abs(change), 0.0)) for change, chosen in changes]))


def measured_directions(
    unknowns: Unknowns, observations: Observations
) -> tuple[Float[Array, "3 ray"], Float[Array, "3 ray"]]:
    """Directions of the measured image points in the object system, and their projection centres.

    The measured direction is the computed one minus the residual at image scale: exact for models that correct the
    measurement, of first order in the residual for models that distort the projection.
    """
    image = observations.ray_image
    turn, centre = tuple(unknowns.rotation[:, image]), tuple(unknowns.centre[:, image])
    interior = unknowns.interior[:, observations.image_camera[image]]
    x, y = central_projection(photo_vector(turn, centre, tuple(unknowns.points[:, observations.ray_point])), 1.0)
    elements = observations.model.elements
    scale = 1 / interior[elements.index("principal_distance")] if "principal_distance" in elements else 1.0
    if "pixel_size" in elements:
        scale = scale * interior[elements.index("pixel_size")]
    v = ray_residuals(unknowns, observations)
    photo = x - v[0] * scale, y - v[1] * scale, -jnp.ones_like(x)
    return jnp.stack(rotation.apply(turn, photo)), jnp.stack(centre)


def parallax_rule(block: Block, delta: float) -> ParallaxRule:
    """The rule for all pairs of successive images of each point.

    Example:
        >>> jb.stopping.parallax_rule(block, 1e-3).limit
        0.001
    """
    require_a(Block, block, "stopping.parallax_rule")
    require_photographs(block, "stopping.parallax_rule")
    return ParallaxRule(delta)


def unknown_rule(block: Block, delta: float, *names: tuple[str, str]) -> UnknownRule:
    """Returns the rule for unknowns with names ("image", "X0"), ("camera", "K1") or ("point", "Z"), or for all.

    Raises: ValueError for a name that is not in the block.

    Example:
        >>> jb.stopping.unknown_rule(block, 1e-3, ("11", "X0")).limit
        0.001
    """
    require_a(Block, block, "stopping.unknown_rule")
    for name in names:
        UnknownRule(delta, (name,)).of(block)
    return UnknownRule(delta, names)


def _unknown_name(who: str, element: str) -> ValueError:
    return ValueError(f"no unknown {element} of {who} in the block; name an image, a camera or a point of it")


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
