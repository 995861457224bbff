"""A block in the order of its elimination.

`Arrangement` is the host's plan: images in elimination order, points in tiles, points that must be kept apart.
`Problem` is what the compiled program takes: arrays of padded shapes and, static, a few sizes and the functions applied
to them, so that the next block of similar size runs in the same program.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.observations import ObservationGroup
from jaxbundle.block.residuals import Observations, group_arrays
from jaxbundle.block.unknowns import Unknowns, corrected_in_angles
from jaxbundle.normals import ordering
from jaxbundle.normals.cells import Tiles, to_cells
from jaxbundle.normals.eliminate import Shape
from jaxbundle.normals.incidence import Views, group_image_pairs, kept_points, own_cameras, views_of
from jaxbundle.normals.kept import KeptRays
from jaxbundle.normals.long_tiles import long_tiling
from jaxbundle.normals.products import AbstractProducts, Finder, class_products, group_products, pair_finder
from jaxbundle.normals.reduced_plan import Method, ReducedPlan, reduced_plan, too_large
from jaxbundle.normals.reduced_system import ReducedSolver
from jaxbundle.normals.tiles import SLOTS, Tiling, tile_width, tiling
from jaxbundle.numerics.devices import dealt
from jaxbundle.numerics.host import array_module, is_concrete, on_device, on_host
from jaxbundle.numerics.shapes import grid_size


class Order(NamedTuple):
    """Where every image, camera and point of the block stands, and how many places there are (padded).

    Parameters stay in the block's order; `parameters` is their number without padding.
    """

    image: Int[np.ndarray, " image"]
    camera: Int[np.ndarray, " camera"]
    point: Int[np.ndarray, " point"]
    images: int
    cameras: int
    points: int
    parameters: int


class Part(NamedTuple):
    """The tiles of points with short or with long tracks, their rays as the tiling numbers them, and their products."""

    tiling: Tiling
    rays: Int[np.ndarray, " ray"]
    products: AbstractProducts | None


@dataclass(frozen=True, eq=False)
class Arrangement:
    """The plan of one block, host data. The last image is a dummy; kept points stand behind the places of the tiles."""

    order: Order
    shape: Shape
    parts: tuple[Part, ...]
    kept: Int[np.ndarray, " kept"]
    kept_rays: Int[np.ndarray, " ray"]
    diagonal_pair: Int[np.ndarray, " image"]
    group_pairs: tuple[Int[np.ndarray, " member"] | None, ...]
    reduced: ReducedSolver
    method: Method
    devices: int

    @property
    def places(self) -> int:
        """Columns of all tiles of all devices."""
        return self.devices * sum(part.tiling.tiles for part in self.parts) * self.shape.width

    @cached_property
    def cell_of_ray(self) -> Int[np.ndarray, " ray"]:
        """Where every ray of the block stands among the cells of all parts, with the rays of kept points behind."""
        place = np.full(sum(len(part.rays) for part in self.parts) + len(self.kept_rays), -1)
        first = 0
        for part in self.parts:
            grid = part.tiling.ray.ravel()
            cell = np.flatnonzero(grid >= 0)
            place[part.rays[grid[cell]]] = first + cell
            first += grid.size
        place[self.kept_rays] = first + np.arange(len(self.kept_rays))
        assert (place >= 0).all(), "a ray has no cell of its own"
        return place


class Arranged(NamedTuple):
    """Unknowns in the order of elimination: `images.points` are the kept points, `tiles` all others."""

    images: Unknowns
    tiles: Float[Array, "3 tile column"]

    def flat(self) -> Unknowns:
        """All points in one row, as the order numbers them."""
        points = jnp.concatenate([self.tiles.reshape(3, -1), self.images.points], 1)
        return eqx.tree_at(lambda u: u.points, self.images, points)


class Problem(eqx.Module):
    """What the solver takes through `args`. `observations` has no rays: they are in `tiles` and `kept_rays`."""

    observations: Observations
    tiles: tuple[Tiles, ...]
    kept_rays: KeptRays
    diagonal_pair: Int[Array, " image"]
    group_pairs: tuple[Int[Array, " member"] | None, ...]
    point_column: Int[Array, " point"]
    camera_image: Int[Array, " camera"]
    reduced: ReducedSolver
    shape: Shape = eqx.field(static=True)
    devices: int = eqx.field(static=True)

    @property
    def free_tiles(self) -> Bool[Array, "3 tile column"]:
        """Which coordinates of the eliminated points are unknown."""
        places = self.observations.point_free.shape[1] - self.shape.kept
        return self.observations.point_free[:, :places].reshape(3, -1, self.shape.width)


def _parts(
    rays: Int[np.ndarray, " ray"],
    views: Views,
    point: Int[np.ndarray, " ray"],
    points: int,
    reduced: ReducedPlan,
    find: Finder,
    devices: int,
    width: int,
) -> tuple[tuple[Part, ...], Int[np.ndarray, " point"]]:
    """Points with short tracks and those with long ones, as far as there are any; the place of every point.

    `rays`: numbers of the rays in the block, sorted by point.
    """
    long = np.bincount(point, minlength=points) > SLOTS
    parts, tile, first = [], np.empty((points, 3), np.int64), 0
    for chosen, plan, plan_products in ((~long, tiling, class_products), (long, long_tiling, group_products)):
        if not chosen.any():
            continue
        mine = np.nonzero(chosen[point])[0]
        number = np.cumsum(chosen) - 1
        seen, count = views.of_ray[mine], len(views.rank)
        t = plan(seen, number[point[mine]], int(chosen.sum()), count, views.centre, devices, width)
        t.slot_image[...] = np.append(views.rank, reduced.images - 1)[t.slot_image]
        t.slot_tile[...] += first
        tile[chosen] = t.point_tile + np.array([0, first, 0])
        # conjugate gradients take diagonal blocks only
        products = None if reduced.method == "pcg" else plan_products(t, find, reduced.pool - 1)
        parts.append(Part(t, rays[mine], products))
        first += t.tiles
    device, tile, column = tile.T
    return tuple(parts), (device * first + tile) * width + column


def arrange(
    structure: Structure,
    groups: tuple[ObservationGroup, ...],
    centres: Float[np.ndarray, "image 3"] | None,
    devices: int,
    solver: Method = "auto",
    direct: bool = True,
) -> Arrangement:
    """Plans the elimination. `centres`: approximate projection centres, a hint for the order of the points.

    `direct`: the reduced matrix must be factorised, because its inverse is wanted.
    """
    images, cameras, own = len(structure.image_names), len(structure.cameras), own_cameras(structure)
    q = len(structure.interior_columns)
    kept = kept_points(structure, groups)
    touching = [group_image_pairs(structure, group, own) for group in groups]
    extra = [pairs for pairs in touching if pairs is not None]
    keep = kept[structure.ray_point]
    rays = np.nonzero(~keep)[0]
    if np.any(np.diff(structure.ray_point[rays]) < 0):
        rays = rays[np.argsort(structure.ray_point[rays], kind="stable")]
    number = np.cumsum(~kept) - 1
    ray_point = number[structure.ray_point[rays]]
    ray_image = structure.ray_image[rays]
    graph = ordering.image_graph(
        ray_image, ray_point, images, int((~kept).sum()), np.concatenate(extra) if extra else None
    )
    d, shared = (6 + q, 0) if own else (6, q)
    padded_kept = grid_size(int(kept.sum()), 8) if kept.any() else 0
    parameters = grid_size(len(structure.parameters), 8) if structure.parameters else 0
    if solver == "auto" and not direct and not extra and too_large(graph, images, d):
        solver = "pcg"
    if solver == "pcg" and extra:
        raise ValueError("conjugate gradients do not take observations that touch two images; take another solver")
    reduced = reduced_plan(graph, images, d, devices, solver)
    row = reduced.rank
    ranked = np.empty((images, 3))
    ranked[row] = centres if centres is not None else np.stack([row, 0 * row, 0 * row], 1)
    width, padded_images = tile_width(len(rays)), reduced.images
    find = pair_finder(reduced.pairs, padded_images, reduced.pool - 1)
    views = views_of(row[ray_image], structure.ray_repeat[rays], ranked)
    parts, place = _parts(rays, views, ray_point, int((~kept).sum()), reduced, find, devices, width)
    places = devices * sum(part.tiling.tiles for part in parts) * width
    point = np.empty(len(kept), np.int64)
    point[~kept], point[kept] = place, places + np.arange(kept.sum())
    camera = row[np.argsort(structure.image_camera)] if own else np.arange(cameras)
    return Arrangement(
        Order(
            row,
            camera,
            point,
            padded_images,
            padded_images if own else cameras,
            places + padded_kept,
            len(structure.parameters),
        ),
        Shape(d, shared, 0 if own else cameras, parameters, padded_kept, reduced.pool, reduced.method == "pcg", width),
        parts,
        np.nonzero(kept)[0],
        np.nonzero(keep)[0],
        find(np.arange(padded_images), np.arange(padded_images)),
        tuple(None if p is None else find(row[p].max(1), row[p].min(1)) for p in touching),
        reduced.solver,
        reduced.method,
        devices,
    )


def spread(values, index: Int[np.ndarray, " entity"], size: int, filling: float | Float[np.ndarray, "row 1"]):
    """Columns of `values` put to their places among `size`; the other places hold `filling`."""
    values = on_host(values)
    xp = np if is_concrete(values) else jnp
    source = np.full(size, values.shape[1])
    source[index] = np.arange(values.shape[1])
    column = np.broadcast_to(np.asarray(filling, values.dtype), (values.shape[0], 1))
    return xp.concatenate([values, column], 1)[:, source]


def _padded(values: Any, size: int) -> Any:
    """Numbers followed by zeros."""
    values = on_host(values)
    return array_module(values).concatenate([values, np.zeros(size - len(values), values.dtype)])


def arranged_unknowns(a: Arrangement, unknowns: Unknowns) -> Arranged:
    """The unknowns of a block in the order of elimination."""
    o = a.order
    rotation = spread(unknowns.rotation, o.image, o.images, np.eye(3).reshape(9, 1))
    points = spread(unknowns.points, o.point, o.points, 0.0)
    images = Unknowns(
        on_device(rotation),
        on_device(spread(unknowns.centre, o.image, o.images, 0.0)),
        on_device(spread(unknowns.interior, o.camera, o.cameras, 1.0)),
        on_device(_padded(unknowns.parameters, a.shape.parameters)),
        on_device(points[:, a.places :]),
    )
    return Arranged(images, dealt(points[:, : a.places].reshape(3, -1, a.shape.width), a.devices, 1))


def restored_unknowns(a: Arrangement, arranged: Arranged) -> Unknowns:
    """The unknowns in the order of the block."""
    images, o = arranged.images, a.order
    tiles, kept = on_host(arranged.tiles), on_host(images.points)
    xp = np if is_concrete((tiles, kept)) else jnp
    points = xp.concatenate([tiles.reshape(3, -1), kept], 1)[:, o.point]
    parts = (
        on_host(images.rotation)[:, o.image],
        on_host(images.centre)[:, o.image],
        on_host(images.interior)[:, o.camera],
        on_host(images.parameters)[: o.parameters],
    )
    return Unknowns(*(on_device(x) for x in (*parts, points)))


def restored_rays(a: Arrangement, cells: list[Array], kept: list[Array]) -> Float[Array, "ray 2"]:
    """What belongs to the cells, two arrays a part, and to the rays of kept points, in the order of the block."""
    xp = np if is_concrete((cells, kept)) else jnp
    columns = []
    for k in range(2):
        parts = [*(on_host(x).ravel() for x in cells[k::2]), *(on_host(x) for x in kept[k : k + 1])]
        columns.append(xp.concatenate(parts)[a.cell_of_ray])
    return on_device(xp.stack(columns, 1))


def problem(a: Arrangement, block: Block) -> Problem:
    """The observations of a block in the order of elimination; concrete ones are laid out by the host."""
    o, structure, in_angles = a.order, block.structure, corrected_in_angles(block.structure)
    image_camera = np.arange(o.images)  # where every image has its own camera, so have the dummies
    if a.shape.cameras:
        image_camera = np.zeros(o.images, int)
        image_camera[o.image] = o.camera[structure.image_camera]
    places = {"image": o.image, "camera": o.camera, "parameter": np.arange(o.parameters), "point": o.point}
    groups = []
    for group in block.groups:
        touched = zip(group.structure.kind.touches, group.structure.indices.T, strict=True)
        groups.append(group_arrays(group, np.stack([places[kind][index] for kind, index in touched])))
    column = np.full(o.points, a.shape.border)
    column[a.places :] = a.shape.first_kept_point + 3 * np.arange(o.points - a.places)
    none = on_device(np.zeros(0, np.int32))
    interior_free = structure.interior_free.T[list(structure.interior_columns)]
    observations = Observations(
        structure.model,
        structure.interior_columns,
        structure.rotation_system,
        on_device(image_camera, jnp.int32),
        none,
        none,
        on_device(np.zeros((2, 0))),
        on_device(np.zeros((2, 0))),
        tuple(groups),
        on_device(spread(structure.exterior_free.T, o.image, o.images, False)),
        on_device(spread(interior_free, o.camera, o.cameras, False)),
        on_device(_padded(structure.parameter_free, a.shape.parameters)),
        on_device(spread(structure.point_free.T, o.point, o.points, False)),
        None if in_angles is None else on_device(spread(in_angles[None], o.image, o.images, False)[0]),
    )
    return Problem(
        observations,
        tuple(_tiles(part, block, a.devices) for part in a.parts),
        _kept_rays(a, block),
        on_device(a.diagonal_pair),
        tuple(None if p is None else on_device(p) for p in a.group_pairs),
        on_device(column, jnp.int32),
        on_device(np.arange(o.cameras)),  # own cameras stand in the order of their images
        a.reduced,
        a.shape,
        a.devices,
    )


def _tiles(part: Part, block: Block, devices: int) -> Tiles:
    """The rays of eliminated points as cells."""
    t = part.tiling
    coordinates, sigmas = on_host(block.rays.coordinates), on_host(block.rays.sigmas)
    xp = np if is_concrete(coordinates) else jnp
    measured = xp.stack([to_cells(coordinates[:, k], t.ray, part.rays) for k in range(2)], 2)
    xp = np if is_concrete(sigmas) else jnp
    weights = xp.stack([to_cells(1 / sigmas[:, k], t.ray, part.rays) for k in range(2)], 2)
    slot_image, slot_tile, measured, weights, chunks = (
        dealt(x, devices) for x in (t.slot_image, t.slot_tile, measured, weights, t.chunks)
    )
    return Tiles(slot_image, slot_tile, measured, weights, chunks, part.products, t.most_tiles, t.group)


def _kept_rays(a: Arrangement, block: Block) -> KeptRays:
    """The rays of kept points, padded with rays of weight 0."""
    size = grid_size(len(a.kept_rays)) if len(a.kept_rays) else 0
    ray = np.zeros(size, int)
    ray[: len(a.kept_rays)] = a.kept_rays
    used = np.arange(size) < len(a.kept_rays)
    image, point = block.structure.ray_image[ray], block.structure.ray_point[ray]
    return KeptRays(
        on_device(a.order.image[image], jnp.int32),
        on_device(np.where(used, a.order.point[point] - a.places, 0), jnp.int32),
        on_device(on_host(block.rays.coordinates)[ray].T),
        on_device(used / on_host(block.rays.sigmas)[ray].T),
    )
