"""Types of the normal equations, which all kernels use; this module has no algorithms.

    OrderedUnknowns   the unknowns in elimination order
    Problem           the observations in that order: tiles of rays, rays of border points, groups of other observations
    Linearised        both at some unknowns, and values computed once per linearisation outside the tiles
    ReducedSums       normal equations of images and border from observations that are not rays of the tiles
    NormalVector      a vector of all unknowns: images, border, points of the tiles
    ReducedVector     a vector of the unknowns of the reduced equations: images, border

Long axes are last: on a CPU, concatenation and addition along them are several times faster.
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
    """Unknowns in elimination order."""

    images: Unknowns
    """Exterior and interior orientation, parameters, and as `points` the border points."""
    tiles: Float[Array, "3 tile column"]
    """The eliminated points."""

    def flat(self) -> Unknowns:
        """All points in one array, those of the tiles first, in the numbering of the observations."""
        points = jnp.concatenate([self.tiles.reshape(3, -1), self.images.points], 1)
        return eqx.tree_at(lambda u: u.points, self.images, points)


class NormalVector(NamedTuple):
    """A vector of all unknowns in elimination order, or several with a leading axis; 0 for fixed ones."""

    images: Float[Any, "*vector image d"]
    border: Float[Any, "*vector border"]
    tiles: Float[Any, "*vector 3 tile column"]


class ReducedVector(NamedTuple):
    """A vector of the unknowns of the reduced equations, or a mask of them."""

    images: Float[Array, "image d"]
    border: Float[Array, " border"]

    def dot(self, other: "ReducedVector") -> Float[Array, ""]:
        """The scalar product with another vector."""
        return jnp.sum(self.images * other.images) + jnp.sum(self.border * other.border)


class Tiles(eqx.Module):
    """Rays of eliminated points as cells, image slots by points.

    The arrays have a leading device axis before the distribution to devices.
    """

    slot_image: Int[Array, "*device chunk slot"]
    """Image of each slot."""
    slot_tile: Int[Array, "*device chunk slot"]
    """Tile of each slot."""
    measured: Float[Array, "*device chunk number slot column"]
    """Measured numbers of each ray."""
    weights: Float[Array, "*device chunk component slot column"]
    """Square roots of the weights of its residuals; 0 in a cell without ray."""
    chunks: Int[Array, "*device"]
    """Number of used chunks."""
    pairs: ClassPairs | GroupPairs | None
    """Blocks of the pairs of slots; None if the reduced matrix is not formed."""
    max_tiles: int = eqx.field(static=True)
    """Maximum number of tiles of a chunk."""
    group: int = eqx.field(static=True)
    """Size of the groups of neighbouring slots that belong to one tile."""


class BorderRays(eqx.Module):
    """Rays of border points, padded with rays of weight 0."""

    image: Int[Array, " ray"]
    point: Int[Array, " ray"]
    """Index of the point, relative to the first border point."""
    measured: Float[Array, "number ray"]
    weights: Float[Array, "component ray"]

    def __bool__(self) -> bool:
        return self.image.shape[0] > 0


class AbstractImageFactor(eqx.Module, Generic[F]):
    """Interface of a factorisation. Blocks are d x d, of the pairs i >= j of images in elimination order."""

    @abc.abstractmethod
    def factorise(self, pairs: Float[Array, "pair d d"]) -> F:
        """The factor L; images without block have a unit row. NaN from the first pivot that is not positive."""

    @abc.abstractmethod
    def pivots(self, factor: F, images: int, d: int) -> Float[Array, "image d"]:
        """Squares of the diagonal of L; arbitrary for an image without block."""

    @abc.abstractmethod
    def forward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """Solves L x = r."""

    @abc.abstractmethod
    def backward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """Solves L^T x = y."""

    @abc.abstractmethod
    def selected_inverse(self, factor: F, d: int) -> Float[Array, "pair d d"]:
        """Blocks of A^-1 of the pairs; 0 for unused blocks."""


ImageFactor = AbstractImageFactor[Any]


class ReducedSolver(eqx.Module):
    """Solver of the reduced normal equations."""

    pair: Int[Array, "pair 2"]
    """Images of each block; the padded number of images for unused blocks."""
    images: ImageFactor
    """Factorisation of the images' part."""


class Problem(eqx.Module):
    """All observations in elimination order."""

    observations: Observations
    """Groups, masks of free unknowns, image model; without rays, which are in `tiles` and `border_rays`."""
    tiles: tuple[Tiles, ...]
    """Points with short tracks and points with long tracks, if any."""
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
        """Mask of the unknown coordinates of the eliminated points."""
        return self.observations.point_free[:, : self.tile_points].reshape(3, -1, self.layout.width)

    @property
    def free(self) -> ReducedVector:
        """Mask of the free unknowns of images and border."""
        o, layout = self.observations, self.layout
        images = jnp.concatenate([o.exterior_free, o.interior_free]) if layout.own_cameras else o.exterior_free
        interior = o.interior_free.T.ravel() if layout.first_parameter else jnp.zeros(0, bool)
        points = o.point_free[:, self.tile_points :].T.ravel()
        return ReducedVector(images.T, jnp.concatenate([interior, o.parameter_free, points]))


class ReducedSums(NamedTuple):
    """Normal equations of images and border; `pairs` is None if no observation touches two images."""

    diagonal: Float[Array, "image d d"]
    gradient: Float[Array, "image d"]
    coupling: Float[Array, "image d border"]
    border: Float[Array, "border border"]
    border_gradient: Float[Array, " border"]
    pairs: Float[Array, "pair d d"] | None


class Linearised(eqx.Module):
    """The equations at some unknowns, of all devices together or of one device."""

    unknowns: OrderedUnknowns
    problem: Problem
    table: Float[Array, "image number"]
    """Table of the images: rotation, centre, interior elements, derivatives of the rotation."""
    d_rotation: Float[Array, "9 3 image"]
    """Derivatives of the rotation matrices with respect to three angles."""
    d2_rotation: Float[Array, "9 3 3 image"] | None
    """Second derivatives; None unless all second derivatives of v^T P v / 2 are requested."""
    sums: ReducedSums
    """Equations of observations other than rays of the tiles."""
    point_terms: Float[Array, "9 tile column"] | None
    """V (6 numbers) and gradient of observations of one eliminated point each; None without such observations."""
    free_tiles: Bool[Array, "3 tile column"]
    """Mask of the unknown coordinates of the eliminated points."""
    axis: str | None = eqx.field(static=True, default=None)
    """Name of the devices' axis inside a program for several devices."""

    @property
    def exact(self) -> bool:
        """Whether all second derivatives are requested."""
        return self.d2_rotation is not None

    @property
    def values(self) -> Float[Array, "image number"]:
        """The table without the derivatives of the rotation."""
        return self.table[:, : self.table.shape[1] - 27]

    @property
    def width(self) -> int:
        """Number of points per tile."""
        return self.unknowns.tiles.shape[2]

    def total(self, x: Any) -> Any:
        """Sums values over the devices."""
        return lax.psum(x, self.axis) if self.axis else x

    def maximum(self, x: Any) -> Any:
        """Maximum over the devices."""
        return lax.pmax(x, self.axis) if self.axis else x
