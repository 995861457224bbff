"""Matching of all images of a point, tied by the image equation, on a textured plane of known height and slope."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases.textures import Waves

import jaxbundle as jb
from jaxbundle.imagery.match_types import Refusal
from jaxbundle.imagery.tied import OrientedWindow, match_tied

MODEL = jb.cameras.CAMERA_MODELS["none"]
INTERIOR = np.array([1000.0, 500.0, 400.0, 1.0, -1.0])
NORMAL = np.array([0.2, -0.1, 1.0]) / np.sqrt(1.05)
POINT = np.array([0.35, -0.2, 2.0])
ANGLES = np.radians([[1.0, -2.0, 3.0], [2.0, 8.0, -4.0], [-9.0, 1.0, 5.0], [3.0, -9.0, 178.0]])
CENTRES = np.array([[0.0, 0.0, 50.0], [-9.0, 1.0, 50.5], [0.5, -9.0, 49.5], [9.0, 0.5, 50.0]])
HALF, REACH, NOISE = 8, 16, 0.3


def matrices():
    return np.array([_matrix(*angles) for angles in ANGLES])


def _matrix(omega, phi, kappa):
    co, so, cp, sp, ck, sk = *_pair(omega), *_pair(phi), *_pair(kappa)
    x, y = np.array([[1, 0, 0], [0, co, -so], [0, so, co]]), np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return x @ y @ np.array([[ck, -sk, 0], [sk, ck, 0], [0, 0, 1]])


def _pair(angle):
    return np.cos(angle), np.sin(angle)


def image_point(rotation, centre, point):
    p = rotation.T @ (point - centre)
    return np.array([500.0 - 1000 * p[0] / p[2], 400.0 + 1000 * p[1] / p[2]])


def window(waves, rotation, centre, middle, half):
    """Grey values of the plane as the image sees it, from whole pixels around a place; and the window's corner."""
    corner = np.floor(middle) - half
    size = 2 * half + 1
    x, y = np.meshgrid(corner[0] + np.arange(size) + 0.5, corner[1] + np.arange(size) + 0.5)
    along = np.stack([(x - 500) / 1000, -(y - 400) / 1000, -np.ones_like(x)], -1) @ rotation.T
    points = centre + along * (((POINT - centre) @ NORMAL) / (along @ NORMAL))[..., None]
    return waves(points[..., 0] * 20, points[..., 1] * 20), corner


@pytest.fixture(scope="module")
def scene():
    waves, rng = Waves(3, shortest=6.0), np.random.default_rng(4)
    windows = []
    for k, (rotation, centre) in enumerate(zip(matrices(), CENTRES, strict=True)):
        half = REACH if k else HALF
        grey, corner = window(waves, rotation, centre, image_point(rotation, centre, POINT) + (k > 0) * 0.4, half)
        grey = 0.8 * grey + 5 * k + NOISE * rng.standard_normal(grey.shape)
        windows.append(OrientedWindow(*map(jnp.asarray, (grey, corner, INTERIOR, rotation.ravel(), centre))))
    searched = OrientedWindow(*(jnp.stack(x) for x in zip(*windows[1:], strict=True)))
    return windows[0], searched, image_point(matrices()[0], CENTRES[0], POINT)


def test_point_and_normal_of_a_plane(scene):
    template, searched, point = scene
    depth = -(matrices()[0].T @ (POINT - CENTRES[0]))[2]
    found = match_tied(MODEL, template, searched, point, depth * 1.004)
    assert int(found.status) == Refusal.MATCHED
    sigma = np.sqrt(np.trace(found.covariance))
    assert sigma < 0.01
    assert np.linalg.norm(np.asarray(found.object_point) - POINT) < 4 * sigma
    assert np.degrees(np.arccos(np.asarray(found.normal) @ NORMAL)) < 1.0
    assert float(found.sigma0) == pytest.approx(NOISE * np.sqrt(2), rel=0.25)
    expected = [
        image_point(r, c, np.asarray(found.object_point)) for r, c in zip(matrices()[1:], CENTRES[1:], strict=True)
    ]
    np.testing.assert_allclose(found.positions, expected, atol=1e-6)


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_images_of_something_else_are_refused(scene):
    template, searched, point = scene
    other = searched._replace(grey=jnp.asarray(np.random.default_rng(1).uniform(0, 255, searched.grey.shape)))
    found = match_tied(MODEL, template, other, point, 48.0)
    assert int(found.status) not in (Refusal.MATCHED,)
