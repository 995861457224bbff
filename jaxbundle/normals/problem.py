"""What the normal equations are made of. No algorithm stands here; every kernel takes these types.

    OrderedUnknowns   the unknowns in the order of elimination
    Problem           the observations in that order: tiles of rays, rays of border points, groups of other observations
    Linearised        both at one place, and what is computed once per linearisation outside of the tiles
    ReducedSums       normal equations of images and border from observations that are not rays of the tiles
    NormalVector      a vector of all unknowns: images, border, points of the tiles
    ReducedVector     a vector of the unknowns of the reduced equations: images, border

Long axes stand last: on a CPU what is concatenated or added along them is several times faster.
"""

import abc
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.residuals import Observations
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals.plan.layout import Layout
from jaxbundle.normals.plan.pair_lists import ClassPairs, GroupPairs

F = TypeVar("F")


class OrderedUnknowns(NamedTuple):
    """Unknowns in the order of elimination."""

    images: Unknowns
    """Exterior and interior orientation, parameters, and as `points` the border points."""
    tiles: Float[Array, "3 tile column"]
    """The points that are eliminated."""

    def flat(self) -> Unknowns:
        """All points in one row, those of the tiles first, as observations number them."""
        points = jnp.concatenate([self.tiles.reshape(3, -1), self.images.points], 1)
        return eqx.tree_at(lambda u: u.points, self.images, points)


class NormalVector(NamedTuple):
    """A vector of all unknowns in the order of elimination, or several with a leading axis; 0 for fixed ones."""

    images: Float[Any, "*vector image d"]
    border: Float[Any, "*vector border"]
    tiles: Float[Any, "*vector 3 tile column"]


class ReducedVector(NamedTuple):
    """A vector of the unknowns of the reduced equations, or a mask of them."""

    images: Float[Array, "image d"]
    border: Float[Array, " border"]

    def dot(self, other: "ReducedVector") -> Float[Array, ""]:
        """Scalar product."""
        return jnp.sum(self.images * other.images) + jnp.sum(self.border * other.border)


class Tiles(eqx.Module):
    """Rays of eliminated points as cells, image slots by points; a leading device axis until a device takes its own."""

    slot_image: Int[Array, "*device chunk slot"]
    """Image of each slot."""
    slot_tile: Int[Array, "*device chunk slot"]
    """Tile of each slot."""
    measured: Float[Array, "*device chunk number slot column"]
    """What is measured of each ray."""
    weights: Float[Array, "*device chunk component slot column"]
    """Square roots of the weights of its residuals; 0 in a cell without ray."""
    chunks: Int[Array, "*device"]
    """Number of chunks in use."""
    pairs: ClassPairs | GroupPairs | None
    """Blocks of the pairs of slots; None where the reduced matrix is not formed."""
    max_tiles: int = eqx.field(static=True)
    """Maximum number of tiles of a chunk."""
    group: int = eqx.field(static=True)
    """Size of the groups of neighbouring slots that belong to one tile."""


class BorderRays(eqx.Module):
    """Rays of border points, padded with rays of weight 0."""

    image: Int[Array, " ray"]
    point: Int[Array, " ray"]
    """Counted from the first border point."""
    measured: Float[Array, "number ray"]
    weights: Float[Array, "component ray"]

    def __bool__(self) -> bool:
        return self.image.shape[0] > 0


class AbstractImageFactor(eqx.Module, Generic[F]):
    """One algorithm. Blocks are d x d, of the pairs i >= j of images in the order of elimination."""

    @abc.abstractmethod
    def factorise(self, pairs: Float[Array, "pair d d"]) -> F:
        """L; images that no block mentions get a unit row. NaN from the first pivot on that is not positive."""

    @abc.abstractmethod
    def pivots(self, factor: F, images: int, d: int) -> Float[Array, "image d"]:
        """Squares of the diagonal of L; any number for an image that no block mentions."""

    @abc.abstractmethod
    def forward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """L^-1 r."""

    @abc.abstractmethod
    def backward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """L^-T y."""

    @abc.abstractmethod
    def selected_inverse(self, factor: F, d: int) -> Float[Array, "pair d d"]:
        """Blocks of A^-1 of the pairs; 0 where a block is not in use."""


ImageFactor = AbstractImageFactor[Any]


class ReducedSolver(eqx.Module):
    """How the reduced equations are solved."""

    pair: Int[Array, "pair 2"]
    """Images of each block; the padded number of images where a block is not in use."""
    images: ImageFactor
    """Factorisation of the images' part."""


class Problem(eqx.Module):
    """All observations in the order of elimination."""

    observations: Observations
    """Groups, masks of what is free, image model; its own rays are empty, they stand in `tiles` and `border_rays`."""
    tiles: tuple[Tiles, ...]
    """Points with short tracks and points with long tracks, as far as there are any."""
    border_rays: BorderRays
    diagonal_pair: Int[Array, " image"]
    """Block of each image with itself."""
    group_pairs: tuple[Int[Array, " member"] | None, ...]
    """Block of the two images that each member of a group touches."""
    reduced: ReducedSolver
    layout: Layout = eqx.field(static=True)
    devices: int = eqx.field(static=True)

    @property
    def tile_points(self) -> int:
        """Positions of points in the tiles of all devices."""
        return self.observations.point_free.shape[1] - self.layout.points

    @property
    def free_tiles(self) -> Bool[Array, "3 tile column"]:
        """Which coordinates of the eliminated points are unknown."""
        return self.observations.point_free[:, : self.tile_points].reshape(3, -1, self.layout.width)

    @property
    def free(self) -> ReducedVector:
        """Which unknowns of images and border are free."""
        o, layout = self.observations, self.layout
        images = jnp.concatenate([o.exterior_free, o.interior_free]) if layout.own_cameras else o.exterior_free
        interior = o.interior_free.T.ravel() if layout.first_parameter else jnp.zeros(0, bool)
        points = o.point_free[:, self.tile_points :].T.ravel()
        return ReducedVector(images.T, jnp.concatenate([interior, o.parameter_free, points]))


class ReducedSums(NamedTuple):
    """Normal equations of images and border; `pairs` is None where no observation touches two images."""

    diagonal: Float[Array, "image d d"]
    gradient: Float[Array, "image d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    border_gradient: Float[Array, " border"]
    pairs: Float[Array, "pair d d"] | None


class Linearised(eqx.Module):
    """The equations at some unknowns, as all devices together or as one device has them."""

    unknowns: OrderedUnknowns
    problem: Problem
    table: Float[Array, "image number"]
    """What every ray takes from its image: rotation, centre, interior elements, derivatives of the rotation."""
    d_rotation: Float[Array, "9 3 image"]
    """Derivatives of the rotation matrices with respect to three angles."""
    d2_rotation: Float[Array, "9 3 3 image"] | None
    """Second derivatives; None unless all second derivatives of v^T P v / 2 are wanted."""
    sums: ReducedSums
    """Observations that are not rays of the tiles."""
    point_terms: Float[Array, "9 tile column"] | None
    """V (6 numbers) and gradient of observations of one eliminated point each; None where there are none."""
    free_tiles: Bool[Array, "3 tile column"]
    """Which coordinates of the eliminated points are unknown."""
    axis: str | None = eqx.field(static=True, default=None)
    """Name of the devices' axis inside of a program for several devices."""

    @property
    def exact(self) -> bool:
        """Whether all second derivatives are wanted."""
        return self.d2_rotation is not None

    @property
    def values(self) -> Float[Array, "image number"]:
        """The table without the derivatives of the rotation."""
        return self.table[:, : self.table.shape[1] - 27]

    @property
    def width(self) -> int:
        """Points per tile."""
        return self.unknowns.tiles.shape[2]

    def total(self, x: Any) -> Any:
        """Sums over the devices."""
        return lax.psum(x, self.axis) if self.axis else x

    def maximum(self, x: Any) -> Any:
        """Maximum over the devices."""
        return lax.pmax(x, self.axis) if self.axis else x
