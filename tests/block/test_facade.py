"""Values of blocks and adjustments by name, and replaced by name."""

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import jaxbundle as jb


@pytest.fixture(scope="module")
def block() -> jb.Block:
    return jb.simulate(1, 4, seed=1, control_sigma=0.05).block


@pytest.fixture(scope="module")
def result(block) -> jb.Adjustment:
    return jb.adjust(block)


def test_points_images_and_cameras_have_names(block):
    s = block.structure
    assert list(block.points) == list(s.point_names) and len(block.images) == 4
    np.testing.assert_array_equal(block.points[s.point_names[5]].coordinates, block.object_points[5])
    image = block.images["1_02"]
    assert image.camera == "camera" and image.standard_deviations is None
    np.testing.assert_array_equal(image.projection_centre, block.exterior.projection_centre[1])
    assert float(block.cameras["camera"]["principal_distance"]) == 153.0
    assert block.cameras["camera"].units["principal_distance"] == "mm"
    assert repr(block.images) == "<4 images: 1_01, 1_02, 1_03, 1_04>"


def test_results_have_names_and_standard_deviations(result):
    name = result.block.structure.point_names[7]
    point = result.points[name]
    np.testing.assert_allclose(point.standard_deviations, result.standard_deviations.object_points[7], rtol=1e-14)
    np.testing.assert_allclose(np.sqrt(np.diagonal(point.covariance)), point.standard_deviations, rtol=1e-12)
    image = result.images["1_03"]
    assert image.standard_deviations is not None and image.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diagonal(image.covariance)), image.standard_deviations, rtol=1e-12)
    assert result.cameras["camera"].standard_deviations == dict.fromkeys(result.cameras["camera"], 0.0)
    assert result.success is True and result.message == "converged"


def test_tables_have_units_in_their_names(result):
    frames = result.to_frames()
    assert {"images", "cameras", "points", "rays"} <= set(frames)
    points = frames["points"].filter(pl.col("point") == result.block.structure.point_names[7])
    assert points["X [m]"][0] == float(result.block.object_points[7, 0])
    assert "sX" in result.to_frames(units=False)["points"].columns


@pytest.mark.usefixtures("unchecked_types")  # a number for a name
@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda b: b.points["1_2"], "no point '1_2'"),
        (lambda b: b.images["1_2"], "no image '1_2'; did you mean '1_02'"),
        (lambda b: b.points[1], "names are text: '1'"),
        (lambda b: b.cameras["camera"]["K1"], "no element of camera camera: 'K1'"),
        (lambda b: b.replace(control={"nobody": (0, 0, 0)}), "no control point 'nobody'"),
        (lambda b: b.replace(interior={"c": {}}), "no camera 'c'"),
        (lambda b: b.replace(object_points=np.zeros((1, 3))), "object_points has the shape"),
        (lambda b: b.replace(distances=np.zeros(1)), "no observations 'distances'; it has control, rays"),
    ],
)
def test_a_name_that_is_not_there_is_told(block, ask, words):
    with pytest.raises((KeyError, ValueError), match=words):
        ask(block)


def test_values_are_replaced_by_name(block):
    s = block.structure
    control = block.groups[0].structure
    name = s.point_names[control.indices[1, 0]]
    new = block.replace(
        sigmas={"rays": 0.5, "control": 0.02},
        control={name: (1.0, 2.0, 3.0)},
        interior={"camera": {"principal_distance": 152.0}},
        object_points={s.point_names[0]: (4.0, 5.0, 6.0)},
        angles=block.exterior.angles + 0.1,
    )
    assert (np.asarray(new.rays.sigmas) == 0.5).all() and (np.asarray(new.groups[0].sigmas) == 0.02).all()
    np.testing.assert_array_equal(new.groups[0].values[1], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(new.groups[0].values[0], block.groups[0].values[0])
    assert float(new.cameras["camera"]["principal_distance"]) == 152.0
    np.testing.assert_array_equal(new.object_points[0], [4.0, 5.0, 6.0])
    np.testing.assert_array_equal(new.replace(control=block.groups[0].values).groups[0].values, block.groups[0].values)


def test_fixed_control_is_replaced_by_name_too():
    block = jb.simulate(1, 4, seed=1).block
    fixed = int(np.flatnonzero(~block.structure.point_free.all(1))[0])
    name = block.structure.point_names[fixed]
    new = block.replace(control={name: (1.0, 2.0, 3.0)})
    np.testing.assert_array_equal(new.object_points[fixed], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="give control by name"):
        block.replace(control=np.zeros((1, 3)))


def test_replaced_values_are_differentiated(block):
    """d sum(w) / d sigma and d y / d c, through names."""

    def weights(sigma):
        return jnp.sum(1 / block.replace(sigmas={"rays": sigma}).rays.sigmas ** 2)

    count = block.rays.sigmas.size
    assert float(jax.grad(weights)(0.5)) == pytest.approx(-2 * count / 0.5**3)
    distance = jax.vmap(lambda c: block.replace(interior={"camera": {"principal_distance": c}}).interior.elements[0])
    np.testing.assert_array_equal(distance(jnp.array([150.0, 151.0]))[:, 0], [150.0, 151.0])


@pytest.mark.parametrize(
    ("image_unit", "metric", "distance", "point"),
    [("px", False, "px", "px"), ("px", True, "mm", "px"), ("mm", False, "mm", "mm")],
)
def test_units_of_interior_elements(image_unit, metric, distance, point):
    """With a pixel size the principal distance is in mm, the principal point in px as the rays."""
    camera = jb.blocks.Camera("c", jb.cameras.CAMERA_MODELS["brown"], image_unit, principal_distance_in_mm=metric)
    assert camera.unit_of("principal_distance") == distance
    assert camera.unit_of("x0") == camera.unit_of("y0") == point
    assert camera.unit_of("K1") == ""


def test_interior_elements_are_fixed_together():
    free = jb.simulate(1, 2, camera=jb.planning.AerialCamera(estimate=("principal_distance", "x0"))).block
    fixed = jb.blocks.with_interior_held(free)
    assert fixed.structure.n_unknowns == free.structure.n_unknowns - 2
    assert not fixed.structure.interior_free.any()
    np.testing.assert_array_equal(fixed.interior.elements, free.interior.elements)
