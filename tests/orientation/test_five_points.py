"""Essential matrices and homographies: published matrices, and random images."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.geometry.polynomial import all_roots
from jaxbundle.geometry.rotation import from_rotation_vector
from jaxbundle.orientation.five_points import essential_matrices
from jaxbundle.orientation.two_images import cross_matrix, homography, motions_from_essential, motions_from_homography

over_samples = jax.jit(jax.vmap(essential_matrices))


def example(shared_data, name: str) -> dict:
    return json.loads((shared_data / "approximate" / f"{name}.json").read_text())


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def random_pairs(number: int, points: int, seed: int, flat: bool = False) -> tuple[np.ndarray, ...]:
    """Unit rays of both images, X2 = R X1 + t, rotations and unit bases."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (number, points, 3)) * [1, 1, 0.0 if flat else 0.5] - [0, 0, 2]
    r = np.moveaxis(np.stack(from_rotation_vector(*rng.normal(0, 0.3, (3, number)))).reshape(3, 3, number), 2, 0)
    t = unit(rng.normal(0, 1, (number, 3)))
    return unit(x), unit(x @ r.swapaxes(1, 2) + 0.6 * t[:, None]), r, t


def test_all_four_published_matrices(shared_data):
    data = example(shared_data, "five_point_poselib")
    e, real = jax.jit(essential_matrices)(jnp.array(data["x1"]), jnp.array(data["x2"]))
    expected = np.array(data["E"]).reshape(-1, 3, 3)
    found = np.asarray(e)[np.asarray(real)] / np.sqrt(2)
    assert len(found) == 4
    distance = np.abs(np.stack([expected[:, None] - found, expected[:, None] + found])).max((3, 4)).min(0)
    assert distance.min(1).max() < 1.5e-10 and distance.min(0).max() < 1.5e-10


@pytest.mark.parametrize("flat", [False, True], ids=["relief", "plane"])
def test_random_images(flat):
    """The true matrix is among the solutions, its rotation and base among the four, and all satisfy the equations."""
    first, second, r, t = random_pairs(500, 5, 1, flat)
    e, real = over_samples(first, second)
    truth = np.asarray(jax.vmap(cross_matrix)(jnp.asarray(t))) @ r
    error = np.minimum(np.abs(e - truth[:, None]).max((2, 3)), np.abs(e + truth[:, None]).max((2, 3)))
    best = np.where(real, error, np.inf).argmin(1)
    error = np.where(real, error, np.inf).min(1)
    assert (error < 1e-6).mean() > 0.995
    good = error < 1e-6
    rotations, bases = jax.vmap(motions_from_essential)(jnp.asarray(e)[np.arange(500), best])
    off = np.abs(rotations - r[:, None]).max((2, 3)) + np.abs(bases - t[:, None]).max(2)
    assert off.min(1)[good].max() < 1e-5
    np.testing.assert_allclose(np.linalg.det(np.asarray(rotations)[good]), 1.0, atol=1e-6)
    left = np.einsum("ski,srij,skj->srk", second, np.asarray(e), first)
    assert np.abs(left[np.asarray(real)]).max() < 1e-10


def test_published_homography(shared_data):
    data = example(shared_data, "homography_opencv")
    k = np.array(data["K"])
    h = np.linalg.inv(k) @ np.array(data["H"]) @ k
    rotations, bases, normals = motions_from_homography(jnp.asarray(h))
    off = np.abs(np.asarray(rotations) - np.array(data["R"])).max((1, 2))
    off += np.abs(np.asarray(bases) - np.array(data["t"])).max(1) + np.abs(np.asarray(normals) - data["n"]).max(1)
    assert off.min() < 1e-12
    rotations, *_ = motions_from_homography(jnp.array(data["H_det_negative_issue_4978"]))
    np.testing.assert_allclose(np.linalg.det(np.asarray(rotations)), 1.0, atol=1e-12)


def test_homography_of_four_rays():
    first, second, r, t = random_pairs(200, 4, 2, flat=True)
    h = jax.vmap(homography)(jnp.asarray(first), jnp.asarray(second))
    rotations, bases, _ = jax.vmap(motions_from_homography)(h)
    off = np.abs(np.asarray(rotations) - r[:, None]).max((2, 3))
    off += np.abs(unit(np.asarray(bases)) - t[:, None]).max(2)
    assert np.median(off.min(1)) < 1e-12 and (off.min(1) < 1e-7).mean() > 0.98


def test_roots_of_the_tenth_degree():
    roots = np.random.default_rng(0).normal(0, 1, (200, 10))
    coefficients = jnp.stack([np.poly(row)[::-1] for row in roots])
    found = np.array(jax.vmap(all_roots)(coefficients), complex)
    np.testing.assert_allclose(np.imag(found), 0, atol=1e-5)
    np.testing.assert_allclose(np.sort(np.real(found), 1), np.sort(roots, 1), atol=1e-5)
