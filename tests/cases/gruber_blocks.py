"""Regular blocks of near-vertical photographs with tie points at the Gruber positions, of which models see six each."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxbundle as jb
from jaxbundle.planning.simulation import exact_coordinates

FORMAT, DISTANCE, SIGMA = 230.0, 153.0, 0.01  # mm: wide angle
BASE, STRIP = 0.4 * FORMAT, 0.8 * FORMAT  # of the photographs: 60 % and 20 % overlap
NUMBER = 10_000.0 / 1000  # scale number, m per mm


def gruber_block(strips: int, models: int) -> jb.Block:
    """Exact observations at true values; every point is free, and nothing is controlled yet.

    Points lie at (k base, j strip / 2), on the axis of a strip for odd j, between two strips for even j.
    """
    k, s = (x.ravel() for x in np.meshgrid(np.arange(models + 1), np.arange(strips)))
    centres = np.stack([k * BASE, (s + 0.5) * STRIP, np.full(len(k), DISTANCE)], 1) * NUMBER
    column, row = (x.ravel() for x in np.meshgrid(np.arange(models + 1), np.arange(2 * strips + 1)))
    points = np.stack([column * BASE, row * STRIP / 2, np.zeros(len(column))], 1) * NUMBER
    near = np.abs(column[None] - k[:, None]) <= 1
    near &= np.abs(row[None] - 2 * s[:, None] - 1) <= 1
    image, point = np.nonzero(near)
    structure = jb.blocks.Structure(
        name=f"{strips} strips of {models} models",
        cameras=(jb.blocks.Camera("camera", jb.cameras.CAMERA_MODELS["none"], "mm"),),
        image_names=tuple(f"{a + 1}_{b + 1:02d}" for a, b in zip(s, k, strict=True)),
        point_names=tuple(f"{a}/{b}" for a, b in zip(column, row, strict=True)),
        image_camera=np.zeros(len(k), np.int32),
        ray_image=image.astype(np.int32),
        ray_point=point.astype(np.int32),
        exterior_free=np.ones((len(k), 6), bool),
        interior_free=np.zeros((1, 5), bool),
        point_free=np.ones((len(points), 3), bool),
        check_point=np.zeros(0, np.int32),
        datum=jb.blocks.Datum("control"),
    )
    block = jb.Block(
        structure,
        jb.blocks.ExteriorOrientation(jnp.asarray(centres), jnp.zeros(centres.shape)),
        jb.blocks.InteriorOrientation(jnp.array([[DISTANCE, 0.0, 0.0, 1.0, 1.0]])),
        jnp.asarray(points),
        jb.blocks.Rays(jnp.zeros((len(image), 2)), jnp.full((len(image), 2), SIGMA)),
        (),
        jb.blocks.CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )
    return eqx.tree_at(lambda b: b.rays.coordinates, block, jnp.asarray(exact_coordinates(block)[0]))


def with_control(block: jb.Block, plan: np.ndarray, heights: np.ndarray) -> jb.Block:
    """With fixed plan coordinates and heights of these points."""
    free = np.ones(block.structure.point_free.shape, bool)
    free[plan, :2] = False
    free[heights, 2] = False
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, point_free=free))


def columns_and_rows(block: jb.Block) -> tuple[np.ndarray, np.ndarray]:
    """Column (in bases) and row (in half strips) of each point."""
    names = [name.split("/") for name in block.structure.point_names]
    return np.array([int(a) for a, _ in names]), np.array([int(b) for _, b in names])


def perimeter(block: jb.Block) -> np.ndarray:
    """Points on the edges of the block."""
    column, row = columns_and_rows(block)
    return (column == 0) | (column == column.max()) | (row == 0) | (row == row.max())
