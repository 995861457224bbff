"""Host plan of the elimination: which points are kept, and the rays sorted into chunks of points.

Kept unknowns have columns of the reduced normal matrix, in this order: six elements an image, the estimated interior
elements of every camera, three coordinates of every kept point. A point is kept if it shares an observation with
anything else than a ray, as the two ends of a distance do; all others are eliminated.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.observations import ObservationGroup

CHUNK_POINTS = 128  # rows of a chunk: large enough for a good matrix product, small enough for the cache


class Plan(eqx.Module):
    """Index arrays of the elimination. A slot without ray is not `used`; a place without point has index `point`."""

    ray: Int[Array, "chunk slot"]
    used: Bool[Array, "chunk slot"]
    place: Int[Array, "chunk slot"]
    point: Int[Array, "chunk place"]
    kept_ray: Int[Array, " kept_ray"]
    kept_point: Int[Array, " kept_point"]
    point_column: Int[Array, " point"]
    size: int = eqx.field(static=True)


def kept_points(structure: Structure, groups: tuple[ObservationGroup, ...]) -> Bool[np.ndarray, " point"]:
    """Points that cannot be eliminated one by one."""
    kept = np.zeros(len(structure.point_names), bool)
    for group in groups:
        touches = group.structure.kind.touches
        if len(touches) > 1:
            for k, kind in enumerate(touches):
                if kind == "point":
                    kept[group.structure.indices[:, k]] = True
    return kept


def plan(structure: Structure, groups: tuple[ObservationGroup, ...]) -> Plan:
    """The plan of a block."""
    points = len(structure.point_names)
    kept = kept_points(structure, groups)
    first = 6 * len(structure.image_names) + len(structure.interior_columns) * len(structure.cameras)
    column = np.full(points, first + 3 * kept.sum())
    column[kept] = first + 3 * np.arange(kept.sum())

    eliminated = np.nonzero(~kept)[0]
    chunks = max(1, -(-len(eliminated) // CHUNK_POINTS))
    point = np.full((chunks, CHUNK_POINTS), points)
    point.ravel()[: len(eliminated)] = eliminated
    position = np.full(points, -1)
    position[eliminated] = np.arange(len(eliminated))

    ray_position = position[structure.ray_point]
    order = np.argsort(ray_position, kind="stable")[int((ray_position < 0).sum()) :]
    chunk = ray_position[order] // CHUNK_POINTS
    count = np.bincount(chunk, minlength=chunks)
    slot = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    ray, used, place = (np.zeros((chunks, max(1, int(count.max()))), kind) for kind in (np.int32, bool, np.int32))
    ray[chunk, slot], used[chunk, slot], place[chunk, slot] = order, True, ray_position[order] % CHUNK_POINTS
    return Plan(
        jnp.asarray(ray),
        jnp.asarray(used),
        jnp.asarray(place),
        jnp.asarray(point, jnp.int32),
        jnp.asarray(np.nonzero(ray_position < 0)[0], jnp.int32),
        jnp.asarray(np.nonzero(kept)[0], jnp.int32),
        jnp.asarray(column, jnp.int32),
        int(first + 3 * kept.sum()),
    )
