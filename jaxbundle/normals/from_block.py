"""From numpy to JAX: makes a `Problem` of a block and its plan, and reorders unknowns in both directions.

Concrete values are arranged by numpy without compilation, traced ones by JAX. Later modules use only JAX.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block, Rays, Structure
from jaxbundle.block.residuals import Observations, group_arrays, padded_members
from jaxbundle.block.unknowns import Unknowns, corrected_in_angles
from jaxbundle.normals.cholesky import DenseCholesky
from jaxbundle.normals.panel_cholesky import PanelCholesky
from jaxbundle.normals.plan.elimination_plan import EliminationPlan, Order, Part
from jaxbundle.normals.plan.layout import EXTERIOR
from jaxbundle.normals.plan.reduced_plan import ReducedPlan
from jaxbundle.normals.problem import BorderRays, NormalVector, OrderedUnknowns, Problem, ReducedSolver, Tiles
from jaxbundle.numerics.devices import AXIS, dealt
from jaxbundle.numerics.host import array_module, is_concrete, on_device, on_host, on_host_or_traced
from jaxbundle.numerics.shapes import grid_size

FEWEST_MEMBERS = 32  # of a padded group: small blocks with equal kinds of observations share a program


def problem(plan: EliminationPlan, block: Block) -> Problem:
    """The observations of a block in elimination order."""
    pairs = tuple(None if pair is None else _padded_pairs(pair) for pair in plan.group_pairs)
    diagonal_pair, group_pairs = on_device((plan.diagonal_pair, pairs))
    rays = on_host(block.rays)
    return Problem(
        _observations(plan, block),
        tuple(_tiles(part, rays, plan.devices) for part in plan.parts),
        _border_rays(plan, block.structure, rays),
        diagonal_pair,
        group_pairs,
        reduced_solver(plan.reduced),
        plan.layout,
        plan.devices,
    )


def to_elimination_order(plan: EliminationPlan, unknowns: Unknowns) -> OrderedUnknowns:
    """The unknowns of a block in elimination order."""
    *images, tiles = _ordered(plan, unknowns)
    return OrderedUnknowns(Unknowns(*images), dealt(tiles, plan.devices, 1))


@on_host_or_traced
def _ordered(_xp: Any, plan: EliminationPlan, unknowns: Unknowns) -> tuple:
    o, tile_points = plan.order, plan.tile_points
    points = spread(unknowns.points, o.point, o.points, 0.0)
    return (
        spread(unknowns.rotation, o.image, o.images, np.eye(3).reshape(9, 1)),
        spread(unknowns.centre, o.image, o.images, 0.0),
        spread(unknowns.interior, o.camera, o.cameras, 1.0),
        spread(unknowns.parameters[None], np.arange(o.parameters), plan.layout.parameters, 0.0)[0],
        points[:, tile_points:],
        points[:, :tile_points].reshape(3, -1, plan.layout.width),
    )


def to_block_order(plan: EliminationPlan, ordered: OrderedUnknowns) -> Unknowns:
    """The unknowns in the order of the block."""
    return Unknowns(*_of_block(plan.order, *ordered))


@on_host_or_traced
def _of_block(xp: Any, o: Order, images: Unknowns, tiles: Any) -> tuple:
    points = xp.concatenate([tiles.reshape(3, -1), images.points], 1)[:, o.point]
    elements = images.rotation[:, o.image], images.centre[:, o.image], images.interior[:, o.camera]
    return *elements, images.parameters[: o.parameters], points


@on_host_or_traced
def rays_to_block_order(xp: Any, plan: EliminationPlan, components: int, values: list) -> Any:
    """Values of the rays in the order of the block, (ray, component).

    Input: one array per component and part for the cells, then one per component for the rays of border points.
    """
    columns = [xp.concatenate([x.ravel() for x in values[k::components]])[plan.cell_of_ray] for k in range(components)]
    return xp.stack(columns, 1)


class BlockVectors(NamedTuple):
    """Vectors of the elements of a block; angles are those of the corrections."""

    exterior: Float[np.ndarray, "vector image 6"]
    interior: Float[np.ndarray, "vector camera column"]
    parameters: Float[np.ndarray, "vector parameter"]
    object_points: Float[np.ndarray, "vector point 3"]


def ordered_vectors(plan: EliminationPlan, structure: Structure, vectors: BlockVectors) -> NormalVector:
    """A `NormalVector` of numpy arrays: vectors of the block in elimination order; 0 for fixed elements."""
    o, layout, count = plan.order, plan.layout, len(vectors.exterior)
    interior = vectors.interior * structure.interior_free[:, list(structure.interior_columns)]
    images, border = np.zeros((count, o.images, layout.image)), np.zeros((count, layout.border))
    images[:, o.image, :EXTERIOR] = vectors.exterior * structure.exterior_free
    if layout.own_cameras:
        images[:, o.camera, EXTERIOR:] = interior
    else:
        border[:, : layout.first_parameter] = interior.reshape(count, -1)
    inside = slice(layout.first_parameter, layout.first_parameter + o.parameters)
    border[:, inside] = vectors.parameters * structure.parameter_free
    points = np.zeros((count, 3, o.points))
    points[:, :, o.point] = (vectors.object_points * structure.point_free).transpose(0, 2, 1)
    border[:, layout.first_point :] = points[:, :, plan.tile_points :].transpose(0, 2, 1).reshape(count, -1)
    tiles = points[:, :, : plan.tile_points].reshape(count, 3, -1, layout.width)
    return NormalVector(images, border, tiles)


def spread(values: Any, index: Int[np.ndarray, " entity"], size: int, filling: bool | float | np.ndarray) -> Any:
    """Puts columns of `values` at their positions among `size`; the other positions contain `filling`.

    `values`: numpy or traced.
    """
    source = np.full(size, values.shape[1])
    source[index] = np.arange(values.shape[1])
    column = np.broadcast_to(np.asarray(filling, values.dtype), (values.shape[0], 1))
    return array_module(values).concatenate([values, column], 1)[:, source]


def _members(count: int) -> int:
    """Size of a padded group."""
    return grid_size(count, FEWEST_MEMBERS) if count else 0


def _padded_pairs(pair: Int[np.ndarray, " member"]) -> Int[np.ndarray, " padded"]:
    return pair[padded_members(len(pair), _members(len(pair)))]


def _observations(plan: EliminationPlan, block: Block) -> Observations:
    """All parts except the rays: groups, masks of free unknowns, and the image model."""
    o, structure, in_angles = plan.order, block.structure, corrected_in_angles(block.structure)
    image_camera = np.arange(o.images)  # if each image has its own camera, dummy images have one too
    if plan.layout.cameras:
        image_camera = np.zeros(o.images, int)
        image_camera[o.image] = o.camera[structure.image_camera]
    positions = {"image": o.image, "camera": o.camera, "parameter": np.arange(o.parameters), "point": o.point}
    groups = []
    for group in block.groups:
        touched = zip(group.structure.kind.touches, group.structure.indices.T, strict=True)
        indices = np.stack([positions[kind][index] for kind, index in touched])
        groups.append(group_arrays(group, indices, _members(indices.shape[1])))
    free = (
        spread(structure.exterior_free.T, o.image, o.images, False),
        spread(structure.interior_free.T[list(structure.interior_columns)], o.camera, o.cameras, False),
        spread(structure.parameter_free[None], np.arange(o.parameters), plan.layout.parameters, False)[0],
        spread(structure.point_free.T, o.point, o.points, False),
        None if in_angles is None else spread(in_angles[None], o.image, o.images, False)[0],
    )
    image_camera, *no_rays = on_device(
        (
            image_camera.astype(np.int32),
            *(np.zeros(0, np.int32), np.zeros(0, np.int32)),
            *(np.zeros((number, 0)) for number in (structure.model.numbers, structure.model.components)),
        )
    )
    exterior_free, interior_free, parameter_free, point_free, free_in_angles = on_device(free)
    return Observations(
        structure.model,
        structure.interior_columns,
        structure.rotation_system,
        image_camera,
        *no_rays,
        groups=tuple(groups),
        exterior_free=exterior_free,
        interior_free=interior_free,
        parameter_free=parameter_free,
        point_free=point_free,
        in_angles=free_in_angles,
    )


def reduced_solver(reduced: ReducedPlan) -> ReducedSolver:
    """The factorisation selected by the plan, with its lists."""
    pair, images, lists = on_device((reduced.padded_pairs, np.arange(reduced.images, dtype=np.int32), reduced.panels))
    if reduced.panels is None:
        return ReducedSolver(pair, DenseCholesky(pair, images))
    return ReducedSolver(pair, PanelCholesky(lists, AXIS if reduced.shared_out else None))


def _tiles(part: Part, rays: Rays, devices: int) -> Tiles:
    """The rays of eliminated points as cells; `rays`: numpy arrays or traced."""
    t = part.tiling

    def cells(values: Any) -> Any:
        return array_module(values).stack(
            [_to_cells(values[:, k], t.ray, part.rays) for k in range(values.shape[1])], 2
        )

    values = cells(rays.coordinates), cells(1 / rays.sigmas)
    slot_image, slot_tile, measured, weights, chunks = (
        dealt(x, devices) for x in (t.slot_image, t.slot_tile, *values, t.chunks)
    )
    return Tiles(slot_image, slot_tile, measured, weights, chunks, on_device(part.pairs), t.max_tiles, t.group)


def _border_rays(plan: EliminationPlan, structure: Structure, rays: Rays) -> BorderRays:
    """The rays of border points, padded with rays of weight 0; `rays`: numpy arrays or traced."""
    count = len(plan.border_rays)
    size = grid_size(count) if count else 0
    ray = np.zeros(size, int)
    ray[:count] = plan.border_rays
    used = np.arange(size) < count
    image = plan.order.image[structure.ray_image[ray]].astype(np.int32)
    point = np.where(used, plan.order.point[structure.ray_point[ray]] - plan.tile_points, 0).astype(np.int32)
    weights = used.astype(float)[None] / rays.sigmas[ray].T
    return BorderRays(*on_device((image, point, rays.coordinates[ray].T, weights)))


def _to_cells(values: Any, cell: Int[np.ndarray, "device chunk slot column"], rays: Int[np.ndarray, " of_part"]) -> Any:
    """A number of each ray at its cell, 0 without ray; `cell`: index of the ray in the part, or -1."""
    if is_concrete(values):
        return np.append(values[rays], 0.0)[cell]
    return _gathered(values, np.append(rays, len(values))[cell])


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _gathered(values: Array, ray: Int[np.ndarray, "device chunk slot column"]) -> Array:
    return jnp.append(values, 0.0)[ray]


@_gathered.defjvp
def _gathered_jvp(ray: np.ndarray, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # a scatter, because its transpose is a gather, which is fast
    flat, place = ray.ravel(), np.full(len(primals[0]), ray.size)
    used = np.flatnonzero(flat < len(place))
    place[flat[used]] = used
    put = jnp.zeros(ray.size).at[place].set(tangents[0], mode="drop", unique_indices=True)
    return _gathered(primals[0], ray), put.reshape(ray.shape)
