"""The plan of one block: elimination order of images, points in tiles, points in the border."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.normals.plan import elimination_order
from jaxbundle.normals.plan.incidence import Views, border_points, group_image_pairs, own_cameras, views_of
from jaxbundle.normals.plan.layout import EXTERIOR, Layout
from jaxbundle.normals.plan.pair_lists import ClassPairs, GroupPairs, class_pairs, group_pairs
from jaxbundle.normals.plan.reduced_plan import Method, ReducedPlan, reduced_plan, too_large
from jaxbundle.normals.plan.tiling import SLOTS, Seen, Tiling, long_tiling, tile_width, tiling
from jaxbundle.numerics.shapes import grid_size


class Order(NamedTuple):
    """Positions of images, cameras and points in elimination order, and padded numbers of positions.

    Parameters are in the block's order; `parameters` is their number without padding.
    """

    image: Int[np.ndarray, " image"]
    camera: Int[np.ndarray, " camera"]
    point: Int[np.ndarray, " point"]
    images: int
    cameras: int
    points: int
    parameters: int


class Part(NamedTuple):
    """Tiles of the points with short or with long tracks."""

    tiling: Tiling
    rays: Int[np.ndarray, " ray"]
    """Rays of the block, in the numbering of the tiling."""
    pairs: ClassPairs | GroupPairs | None
    """Blocks of pairs of slots; None if the reduced matrix is not formed."""


@dataclass(frozen=True, eq=False)
class EliminationPlan:
    """The plan of one block, host data. The last image is a dummy; border points follow those of the tiles."""

    order: Order
    layout: Layout
    parts: tuple[Part, ...]
    border_rays: Int[np.ndarray, " ray"]
    """Rays of the border points."""
    diagonal_pair: Int[np.ndarray, " image"]
    """Block of each image with itself."""
    group_pairs: tuple[Int[np.ndarray, " member"] | None, ...]
    """Block of the two images that a member touches; None for groups that touch only one."""
    reduced: ReducedPlan
    devices: int

    @property
    def tile_points(self) -> int:
        """Positions of points in the tiles of all devices, before those of the border points."""
        return self.devices * sum(part.tiling.tiles for part in self.parts) * self.layout.width

    @cached_property
    def cell_of_ray(self) -> Int[np.ndarray, " ray"]:
        """Position of each ray of the block among the cells of all parts, followed by the rays of border points."""
        position = np.full(sum(len(part.rays) for part in self.parts) + len(self.border_rays), -1)
        first = 0
        for part in self.parts:
            grid = part.tiling.ray.ravel()
            cell = np.flatnonzero(grid >= 0)
            position[part.rays[grid[cell]]] = first + cell
            first += grid.size
        position[self.border_rays] = first + np.arange(len(self.border_rays))
        assert (position >= 0).all(), "a ray has no separate cell"
        return position

    @property
    def border_points(self) -> Int[np.ndarray, " border_point"]:
        """Points of the block in the border, in its order."""
        return np.flatnonzero(self.order.point >= self.tile_points)

    @property
    def method(self) -> Method:
        """Solver of the reduced normal equations."""
        return self.reduced.method


class _Tracks(NamedTuple):
    """Rays of the eliminated points, sorted by point; numbers of points are without the border."""

    rays: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]
    image: Int[np.ndarray, " ray"]
    points: int


class _Wanted(NamedTuple):
    """Devices, solver of the reduced equations, and whether their matrix must be factorised."""

    devices: int
    solver: Method
    direct: bool


def plan_elimination(
    structure: Structure,
    groups: tuple[ObservationGroup, ...],
    centres: Float[np.ndarray, "image 3"] | None,
    devices: int,
    solver: Method = "auto",
    *,
    direct: bool = True,
) -> EliminationPlan:
    """Plans the elimination of a block.

    Args:
        structure, groups: of the block; only indices and masks of the groups are used, not values.
        centres: approximate projection centres (image, 3), which are used to sort the points; None if unknown.
        devices: JAX devices that share the tiles.
        solver: solver of the reduced normal equations.
        direct: whether the reduced matrix must be factorised, because its inverse is needed.

    Raises:
        ValueError: for conjugate gradients with observations that touch two images.
    """
    own, images = own_cameras(structure), len(structure.image_names)
    in_border = border_points(structure, groups)
    touching = [group_image_pairs(structure, group, own) for group in groups]
    tracks, border_rays = _tracks(structure, in_border)
    q = len(structure.interior_columns)
    d = EXTERIOR + q if own else EXTERIOR
    reduced = _reduced(tracks, images, d, touching, _Wanted(devices, solver, direct))
    rank, find = reduced.rank, reduced.block_of
    ranked = np.empty((images, 3))
    ranked[rank] = centres if centres is not None else np.stack([rank, 0 * rank, 0 * rank], 1)
    width = tile_width(len(tracks.rays))
    views = views_of(rank[tracks.image], structure.ray_repeat[tracks.rays], ranked)
    parts, position = _parts(tracks, views, reduced, devices, width)
    tile_points = devices * sum(part.tiling.tiles for part in parts) * width
    point = np.empty(len(in_border), np.int64)
    point[~in_border], point[in_border] = position, tile_points + np.arange(in_border.sum())
    padded_points = grid_size(int(in_border.sum()), 8) if in_border.any() else 0
    parameters = grid_size(len(structure.parameters), 8) if structure.parameters else 0
    cameras = reduced.images if own else len(structure.cameras)
    camera = rank[np.argsort(structure.image_camera)] if own else np.arange(cameras)
    layout = Layout(
        image=d,
        shared=0 if own else q,
        cameras=0 if own else cameras,
        parameters=parameters,
        points=padded_points,
        pairs=reduced.blocks,
        implicit=reduced.method == "pcg",
        width=width,
    )
    return EliminationPlan(
        Order(rank, camera, point, reduced.images, cameras, tile_points + padded_points, len(structure.parameters)),
        layout,
        parts,
        border_rays,
        find(np.arange(reduced.images), np.arange(reduced.images)),
        tuple(None if pair is None else find(rank[pair].max(1), rank[pair].min(1)) for pair in touching),
        reduced,
        devices,
    )


def _tracks(structure: Structure, in_border: np.ndarray) -> tuple[_Tracks, Int[np.ndarray, " border_ray"]]:
    """The rays of the eliminated points, and the indices of all other rays."""
    of_border = in_border[structure.ray_point]
    rays = np.nonzero(~of_border)[0]
    if np.any(np.diff(structure.ray_point[rays]) < 0):
        rays = rays[np.argsort(structure.ray_point[rays], kind="stable")]
    number = np.cumsum(~in_border) - 1
    point, image = number[structure.ray_point[rays]], structure.ray_image[rays]
    return _Tracks(rays, point, image, int((~in_border).sum())), np.nonzero(of_border)[0]


def _reduced(tracks: _Tracks, images: int, d: int, touching: list[np.ndarray | None], wanted: _Wanted) -> ReducedPlan:
    """The plan of the reduced equations; `touching`: pairs of images connected by groups of observations."""
    extra = [pairs for pairs in touching if pairs is not None]
    joined = np.concatenate(extra) if extra else None
    graph = elimination_order.image_graph(tracks.image, tracks.point, images, tracks.points, joined)
    devices, solver, direct = wanted
    if solver == "auto" and not direct and not extra and too_large(graph, images, d):
        solver = "pcg"
    if solver == "pcg" and extra:
        raise ValueError("conjugate gradients do not support observations that touch two images; use another solver")
    return reduced_plan(graph, images, d, devices, solver)


def _parts(
    tracks: _Tracks, views: Views, reduced: ReducedPlan, devices: int, width: int
) -> tuple[tuple[Part, ...], Int[np.ndarray, " point"]]:
    """Points with short tracks and with long ones, if any; the position of each point."""
    long = np.bincount(tracks.point, minlength=tracks.points) > SLOTS
    parts, tile, first = [], np.empty((tracks.points, 3), np.int64), 0
    for chosen, plan, list_pairs in ((~long, tiling, class_pairs), (long, long_tiling, group_pairs)):
        if not chosen.any():
            continue
        mine = np.nonzero(chosen[tracks.point])[0]
        number = np.cumsum(chosen) - 1
        seen = views.of_ray[mine]
        t = plan(Seen(seen, number[tracks.point[mine]], int(chosen.sum()), views.centre), devices, width)
        t.slot_image[...] = np.append(views.rank, reduced.images - 1)[t.slot_image]
        t.slot_tile[...] += first
        tile[chosen] = t.point_tile + np.array([0, first, 0])
        pairs = None if reduced.method == "pcg" else list_pairs(t, reduced.block_of, reduced.blocks - 1)
        parts.append(Part(t, tracks.rays[mine], pairs))
        first += t.tiles
    device, tile, column = tile.T
    return tuple(parts), (device * first + tile) * width + column
