"""Three points: every solution, and only solutions."""

import json
from itertools import combinations

import jax
import numpy as np
import pytest

from jaxbundle.geometry.rotation import from_quaternion, from_rotation_vector
from jaxbundle.orientation.three_point_resections import three_point_resection

over_images = jax.jit(jax.vmap(three_point_resection))


def matrices(number: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(0, 1.5, (3, number))
    return np.moveaxis(np.stack(from_rotation_vector(*vectors)).reshape(3, 3, number), 2, 0)


def check(found, points: np.ndarray, directions: np.ndarray) -> None:
    """Rotations are proper, and rotated rays meet the points."""
    for k in np.flatnonzero(found.exact):
        r, x0 = np.asarray(found.rotation[k]), np.asarray(found.projection_centre[k])
        np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(r) > 0
        seen = (points - x0) @ r
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        np.testing.assert_allclose(seen, directions / np.linalg.norm(directions, axis=1, keepdims=True), atol=1e-7)


def example(shared_data, name: str) -> dict:
    return json.loads((shared_data / "approximate" / f"{name}.json").read_text())


def test_four_solutions_two_of_which_share_a_ratio(shared_data):
    """Fischler and Bolles 1981."""
    given = example(shared_data, "p3p_fischler_bolles")
    side, cosine = np.sqrt(given["side_squared"]), given["cosine"]
    points = side / np.sqrt(3) * np.array([[np.cos(a), np.sin(a), 0] for a in np.radians([90, 210, 330])])
    gram = np.full((3, 3), cosine) + (1 - cosine) * np.eye(3)
    directions = np.linalg.cholesky(gram)
    found = three_point_resection(points, directions)
    assert found.count == 4 and found.words == ""
    np.testing.assert_allclose(sorted(map(tuple, np.asarray(found.distances).round(9).tolist())), given["distances"])
    check(found, points, directions)


def test_exact_projections_return_the_orientation(shared_data):
    """The points and poses of COLMAP's test; 5 of the 8 points lie on a line."""
    x = np.array(example(shared_data, "p3p_colmap")["object"], float)
    triples = np.array(list(combinations(range(8), 3)))
    for qx in np.arange(0, 1, 0.2):
        r = np.stack(from_quaternion(1.0, qx, 0.0, 0.0)).reshape(3, 3)
        for tx in (0.0, 0.4, 0.9):
            seen = x @ r.T + [tx, 0, 0]
            found = over_images(x[triples], seen[triples])
            truth = -r.T @ [tx, 0, 0]
            error = np.abs(np.asarray(found.projection_centre) - truth).max(-1)
            error = np.where(found.exact, error, np.inf).min(1)
            line = np.asarray(found.flatness) < 1e-3
            assert line.sum() == 10
            usable = ~line & (np.abs(np.asarray(found.determinant)).min(1, initial=1, where=found.exact) > 1e-4)
            assert usable.sum() >= 40 and error[usable].max() < 1e-6


def test_traps(shared_data):
    given = example(shared_data, "p3p_degenerate")["g9nkn_p3p_problem_1"]
    points, directions = np.array(given["object"], float), np.array(given["rays_xyz"])
    found = three_point_resection(points, directions)
    assert found.count == 2
    distances = np.asarray(found.distances)[np.asarray(found.exact)]
    np.testing.assert_allclose(sorted(distances.tolist()), sorted(given["solutions_distances"]), rtol=1e-9)
    check(found, points, directions)


def test_danger_cylinder_is_told(shared_data):
    given = example(shared_data, "p3p_degenerate")["midjji_pnp_3"]
    found = three_point_resection(given["object"], given["rays_xyz"])
    numbers = np.isfinite(found.distances).all(1)
    assert numbers.any()
    np.testing.assert_allclose(np.asarray(found.distances)[numbers][0], given["solutions_distances"][0], rtol=1e-6)
    assert "danger cylinder" in found.words


def test_points_on_a_line_are_told():
    x = np.array([[0, 0, 0], [1, 1, 0], [3, 3, 0.0]])
    assert "lie on a line" in three_point_resection(x, x - [1, 0, 5]).words


def test_random_images_have_their_true_orientation():
    """Also where rays are more than 90 degrees apart, and of right-angled and of regular triangles."""
    rng, number = np.random.default_rng(1), 3000
    points = rng.normal(0, 1, (number, 3, 3))
    points[:500] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    points[500:1000] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    centre, r = rng.normal(0, 2, (number, 1, 3)), matrices(number, 2)
    directions = (points - centre) @ r
    found = over_images(points, directions)
    error = np.abs(np.asarray(found.projection_centre) - centre).max(-1)
    error = np.where(found.exact, error, np.inf).min(1)
    assert (error < 1e-6).mean() > 0.998
    true = np.where(found.exact, np.abs(np.asarray(found.projection_centre) - centre).max(-1), np.inf).argmin(1)
    well = np.abs(np.asarray(found.determinant)[np.arange(number), true]) > 1e-3
    well &= np.asarray(found.flatness) > 1e-3
    assert well.sum() > 2900 and error[well].max() < 1e-5


def test_no_solution_is_missed():
    """Against Newton's method from many starts."""
    rng, number = np.random.default_rng(4), 25
    points, centre = rng.normal(0, 1, (number, 3, 3)), rng.normal(0, 1, (number, 1, 3))
    directions = points - centre
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    found, total = over_images(points, directions), 0
    for k in range(number):
        i, j = np.array([1, 0, 0]), np.array([2, 2, 1])
        cosine = (directions[k][i] * directions[k][j]).sum(1)
        side = ((points[k][i] - points[k][j]) ** 2).sum(1)
        s = rng.uniform(0, 6, (400, 3))
        for _ in range(40):
            f = s[:, i] ** 2 + s[:, j] ** 2 - 2 * s[:, i] * s[:, j] * cosine - side
            jacobian = np.zeros((400, 3, 3))
            jacobian[:, range(3), i] = 2 * (s[:, i] - s[:, j] * cosine)
            jacobian[:, range(3), j] = 2 * (s[:, j] - s[:, i] * cosine)
            s = s - np.linalg.solve(jacobian + 1e-14 * np.eye(3), f[..., None])[..., 0]
        f = s[:, i] ** 2 + s[:, j] ** 2 - 2 * s[:, i] * s[:, j] * cosine - side
        roots = s[(np.abs(f).max(1) < 1e-11) & (s > 0).all(1)]
        roots = np.unique(roots.round(6), axis=0)
        total += len(roots)
        distance = np.abs(roots[:, None] - np.asarray(found.distances)[k][None]).max(-1)
        assert (np.nanmin(distance, 1) < 1e-5).all(), k
        assert found.count[k] <= len(roots)
    assert total > 40


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_shapes_are_told():
    with pytest.raises(ValueError, match=r"shape \(4, 3\) and directions of shape \(3, 3\); give"):
        three_point_resection(np.zeros((4, 3)), np.zeros((3, 3)))
