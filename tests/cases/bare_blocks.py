"""Blocks of rays alone, with known truth: orientations and points are not given, some rays are wrong."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxbundle as jb
from jaxbundle.block.block import (
    Block,
    Camera,
    CheckPoints,
    Datum,
    ExteriorOrientation,
    InteriorOrientation,
    Rays,
    Structure,
)
from jaxbundle.orientation.to_object import closed_form

C, HALF, SIGMA = 1000.0, 700.0, 0.5  # px: principal distance, half of the format, standard deviation
Scene = tuple[np.ndarray, np.ndarray, np.ndarray]
KINDS = ("flat", "hilly", "cross strips", "strip", "ring", "rotations", "oblique")


class Bare(NamedTuple):
    """`block`: without orientations and points; `rotation` (object_from_image), `centre`, `points`: the truth."""

    block: Block
    rotation: np.ndarray
    centre: np.ndarray
    points: np.ndarray
    wrong: np.ndarray


def looking(direction: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Rotation object_from_image of a camera with a direction of view."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def aerial(strips: int, images: int, points: int, rng: np.random.Generator, relief: float = 100.0) -> Scene:
    """Centres, rotations and points of strips flown to and fro at 1000 m, 60 % and 30 % overlap."""
    k, i = np.meshgrid(np.arange(images), np.arange(strips))
    centre = np.c_[560.0 * k.ravel(), 980.0 * i.ravel(), np.full(k.size, 1000.0)] + rng.normal(0, 10, (k.size, 3))
    kappa = np.where(i.ravel() % 2, np.pi, 0.0) + rng.normal(0, 0.05, k.size)
    rotation = (
        Rotation.from_rotvec(rng.normal(0, 0.02, (k.size, 3))) * Rotation.from_rotvec(kappa[:, None] * [0, 0, 1])
    ).as_matrix()
    low, high = centre[:, :2].min(0) - 600, centre[:, :2].max(0) + 600
    xy = rng.uniform(low, high, (points * k.size, 2))
    return centre, rotation, np.c_[xy, rng.uniform(-relief / 2, relief / 2, len(xy))]


def scene(kind: str, rng: np.random.Generator, points: int = 60) -> Scene:
    """Centres, rotations and points of a kind of block."""
    if kind in ("flat", "hilly"):
        return aerial(3, 5, points, rng, 0.0 if kind == "flat" else 200.0)
    if kind == "strip":
        return aerial(1, 10, points, rng)
    if kind == "cross strips":
        centre, rotation, ground = aerial(2, 4, points, rng)
        across = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
        middle = centre.mean(0)
        other = (centre - middle) @ across.T + middle + [0, 0, 30]
        ground = np.concatenate([ground, (ground - middle) @ across.T + middle])
        return np.concatenate([centre, other]), np.concatenate([rotation, across @ rotation]), ground
    if kind == "ring":
        angle = np.arange(16) * 2 * np.pi / 16
        centre = np.c_[4 * np.cos(angle), 4 * np.sin(angle), np.full(16, 0.5)] + rng.normal(0, 0.1, (16, 3))
        rotation = np.stack([looking(-c, np.array([0, 0, 1.0])) for c in centre])
        ball = rng.normal(size=(points * 6, 3))
        ball = 1.2 * ball / np.linalg.norm(ball, axis=1, keepdims=True) * rng.uniform(0.8, 1, (len(ball), 1))
        return centre, rotation, ball
    if kind == "rotations":
        stands = np.c_[np.tile([-3.0, -1.0, 1.0, 3.0], 2), np.repeat([-2.0, 2.0], 4), np.full(8, 1.5)]
        stands += rng.normal(0, 0.1, stands.shape)
        centre = np.repeat(stands, 3, axis=0)
        turns = np.tile([-0.5, 0.0, 0.5], 8)
        view = np.c_[np.sin(turns), np.cos(turns), 0.05 * rng.normal(size=24)]
        rotation = np.stack([looking(v, np.array([0, 0, 1.0])) for v in view])
        wall = np.c_[rng.uniform(-9, 9, points * 8), rng.uniform(6, 9, points * 8), rng.uniform(-2, 5, points * 8)]
        return centre, rotation, wall
    centre, rotation, ground = aerial(2, 5, points, rng)
    forward = Rotation.from_rotvec([np.radians(35), 0, 0]).as_matrix()
    return np.repeat(centre, 2, axis=0), np.concatenate([np.stack([r, r @ forward]) for r in rotation]), ground


def bare(centre: np.ndarray, rotation: np.ndarray, points: np.ndarray, share: float, rng: np.random.Generator) -> Bare:
    """A block that sees the points, with a share of rays that lie anywhere on their images."""
    p = np.einsum("nji,npj->npi", rotation, points[None] - centre[:, None])
    xy = -C * p[..., :2] / p[..., 2:]
    seen = (p[..., 2] < 0) & (np.abs(xy) < HALF).all(2)
    outward = points - points.mean(0)
    radius = np.linalg.norm(outward, axis=1)
    if np.ptp(radius) < 0.3 * radius.max():  # a body hides its other side
        seen &= np.einsum("pk,npk->np", outward, centre[:, None] - points[None]) > 0
    seen &= seen.sum(0) >= 2
    image, point = np.nonzero(seen)
    used, point = np.unique(point, return_inverse=True)
    measured = xy[seen] + rng.normal(0, SIGMA, (len(image), 2))
    wrong = rng.random(len(image)) < share
    measured[wrong] = rng.uniform(-HALF, HALF, (wrong.sum(), 2))
    return Bare(block_of(image, point, measured, len(centre)), rotation, centre, points[used], wrong)


def block_of(image: np.ndarray, point: np.ndarray, measured: np.ndarray, images: int) -> Block:
    """A block of one camera whose rays alone are given."""
    count = int(point.max()) + 1
    structure = Structure(
        name="bare",
        cameras=(Camera("camera", jb.cameras.CAMERA_MODELS["none"], "px", int(2 * HALF), int(2 * HALF)),),
        image_names=tuple(f"i{k}" for k in range(images)),
        point_names=tuple(f"p{k}" for k in range(count)),
        image_camera=np.zeros(images, np.int32),
        ray_image=image.astype(np.int32),
        ray_point=point.astype(np.int32),
        exterior_free=np.ones((images, 6), bool),
        interior_free=np.zeros((1, 5), bool),
        point_free=np.ones((count, 3), bool),
        check_point=np.zeros(0, np.int32),
    )
    nothing = jnp.full((images, 3), jnp.nan)
    return Block(
        structure,
        ExteriorOrientation(nothing, nothing),
        InteriorOrientation(jnp.asarray([[C, 0.0, 0.0, 1.0, 1.0]])),
        jnp.full((count, 3), jnp.nan),
        Rays(jnp.asarray(measured), jnp.full((len(image), 2), SIGMA)),
        (),
        CheckPoints(jnp.zeros((0, 3)), jnp.zeros((0, 3))),
    )


def without_start(block: Block) -> Block:
    """A block without orientations and without coordinates of points that are not fixed."""
    s = block.structure
    if s.datum.kind == "fixed":
        s = dataclasses.replace(s, datum=Datum("open"), exterior_free=np.ones_like(s.exterior_free))
    nothing = jnp.full(block.exterior.angles.shape, jnp.nan)
    points = jnp.where(jnp.asarray(s.point_free), jnp.nan, block.object_points)
    return eqx.tree_at(
        lambda b: (b.exterior.projection_centre, b.exterior.angles, b.object_points),
        dataclasses.replace(block, structure=s),
        (nothing, nothing, points),
    )


def attitudes(block: Block) -> np.ndarray:
    """Rotation matrices object_from_image of all images."""
    system, angles = block.structure.rotation_system, np.asarray(block.exterior.angles)
    return np.stack([np.asarray(x) for x in system.rotation_from_angles(*angles.T)], 1).reshape(-1, 3, 3)


def errors(found: Block, truth: Bare) -> tuple[np.ndarray, np.ndarray]:
    """Angles in degrees, and distances of the centres over the mean distance of the points, after a similarity.

    NaN for images without an orientation.
    """
    centre, rotation = np.asarray(found.exterior.projection_centre), attitudes(found)
    known = np.isfinite(centre).all(1) & np.isfinite(rotation).all((1, 2))
    u, _, vt = np.linalg.svd((truth.rotation[known] @ rotation[known].swapaxes(1, 2)).sum(0))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    angle = np.full(len(centre), np.nan)
    difference = truth.rotation[known].swapaxes(1, 2) @ turn @ rotation[known]
    angle[known] = np.degrees(Rotation.from_matrix(difference).magnitude())
    scale, r, shift, _ = closed_form(centre[known], truth.centre[known], np.ones(known.sum()))
    off = np.linalg.norm(scale * centre @ r.T + shift - truth.centre, axis=1)
    s = found.structure
    depth = np.linalg.norm(truth.points[s.ray_point] - truth.centre[s.ray_image], axis=1).mean()
    return angle, off / depth
