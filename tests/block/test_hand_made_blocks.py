"""Blocks put together wrongly in Python are refused in the user's names, with everything that is wrong at once."""

import dataclasses
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.all_observations import strip
from cases.block_variants import changed

import jaxbundle as jb
from jaxbundle.block.consistency import inconsistencies
from jaxbundle.block.findings import Kind
from jaxbundle.block.magnitudes import repeated_rows
from jaxbundle.block.observation_kinds import ObservationKind
from jaxbundle.camera.forward import BAL

pytestmark = pytest.mark.usefixtures("unchecked_types")


@pytest.fixture(scope="module")
def block():
    return strip()


def refused(block) -> list[str]:
    """What `adjust` says of a block, a line a problem; nothing is solved."""
    with pytest.raises(jb.BlockError) as caught:
        jb.adjust(block)
    assert caught.value.problems == tuple(jb.blocks.validate(block))
    return [problem.what for problem in caught.value.problems]


def put(block, where, value):
    """The block with another leaf."""
    return eqx.tree_at(where, block, value)


def at(array, index, value):
    """A copy with another element."""
    copy = np.array(array)
    copy[index] = value
    return copy


STRUCTURES = {
    "ray 17 names image 9, there are 3 images": lambda s: {"ray_image": at(s.ray_image, 17, 9)},
    "ray 3 names image -1, there are 3 images": lambda s: {"ray_image": at(s.ray_image, 3, -1)},
    "ray 0 names point 999": lambda s: {"ray_point": at(s.ray_point, 0, 999)},
    "image 2 names camera 1, there is 1 camera": lambda s: {"image_camera": at(s.image_camera, 2, 1)},
    "check point 0 names point 500": lambda s: {"check_point": np.array([500])},
    "ray_point (indices of points) has the shape": lambda s: {"ray_point": s.ray_point[:-1]},
    "ray_image (indices of images) is an array of float64": lambda s: {"ray_image": s.ray_image.astype(float)},
    "ray_image (indices of images) is of type list": lambda s: {"ray_image": s.ray_image.tolist()},
    "image_camera (indices of cameras) has the shape (2,)": lambda s: {"image_camera": s.image_camera[:2]},
    "exterior_free has the shape (2, 6)": lambda s: {"exterior_free": s.exterior_free[:2]},
    "exterior_free is an array of int64": lambda s: {"exterior_free": s.exterior_free.astype(int)},
    "point_free has the shape": lambda s: {"point_free": s.point_free[:, :2]},
    "interior_free has the shape (1, 2)": lambda s: {"interior_free": s.interior_free[:, :2]},
    "is free, and cannot be estimated": lambda s: {"interior_free": np.ones_like(s.interior_free)},
    "exterior.angles has the shape (3, 3)": lambda s: {"image_names": (*s.image_names, "one more")},
    "the name 'twice' is given twice": lambda s: {"image_names": ("twice", "twice", "other")},
    "the points are of type list": lambda s: {"point_names": list(s.point_names)},
    "there are no cameras": lambda s: {"cameras": ()},
    "the cameras are of type tuple": lambda s: {"cameras": ("camera",)},
    "the kind of datum is 'none'": lambda s: {"datum": jb.blocks.Datum("none")},
    "the datum names image 'x'": lambda s: {"datum": jb.blocks.Datum("fixed", (("x", "X0"),))},
}
VALUES = {
    "object_points has the shape": (lambda b: b.object_points, jnp.zeros((3, 3))),
    "object_points is an array of int64": (lambda b: b.object_points, "int"),
    "object_points is an array of float32": (lambda b: b.object_points, "float32"),
    "exterior.projection_centre has the shape (3, 2)": (lambda b: b.exterior.projection_centre, jnp.zeros((3, 2))),
    "exterior.angles is None, not an array": (lambda b: b.exterior.angles, None),
    "interior.elements has the shape (1, 1)": (lambda b: b.interior.elements, jnp.ones((1, 1))),
    "rays.coordinates has the shape (5, 2)": (lambda b: b.rays.coordinates, jnp.zeros((5, 2))),
    "rays.sigmas has the shape (5, 2)": (lambda b: b.rays.sigmas, jnp.ones((5, 2))),
    "check_points.coordinates has the shape (4, 3)": (lambda b: b.check_points.coordinates, jnp.zeros((4, 3))),
    "parameters has the shape (2,)": (lambda b: b.parameters, jnp.zeros(2)),
    "values of control has the shape": (lambda b: b.groups[0].values, jnp.zeros((1, 3))),
    "sigmas of control has the shape": (lambda b: b.groups[0].sigmas, jnp.zeros((1, 3))),
    "constants of control has the shape": (lambda b: b.groups[0].constants, jnp.zeros((1, 3))),
    "groups is of type list": (lambda b: b.groups, []),
    "group 0 is of type str": (lambda b: b.groups, ("control",)),
}


@pytest.mark.parametrize("words", STRUCTURES)
def test_structure(block, words):
    found = refused(changed(block, **STRUCTURES[words](block.structure)))
    assert any(words in what for what in found), found


@pytest.mark.parametrize("words", VALUES)
def test_values(block, words):
    where, value = VALUES[words]
    if isinstance(value, str):
        value = where(block).astype(value)
    found = refused(put(block, where, value))
    assert any(words in what for what in found), found


GROUPS = {
    "row 1 of distances names point 9999": lambda: ([[0, 1], [1, 9999]], 1),
    "indices of distances has the shape": lambda: ([[0], [1]], 1),
    "values of distances has the shape (2, 3)": lambda: ([[0, 1], [1, 2]], 3),
}


@pytest.mark.parametrize("words", GROUPS)
def test_groups(block, words):
    indices, columns = GROUPS[words]()
    ones = np.ones((2, columns))
    group = jb.observations.observation_group(jb.observations.DISTANCES, np.array(indices), ones, ones)
    found = refused(dataclasses.replace(block, groups=(*block.groups, group)))
    assert any(words in what for what in found), found


def test_numbers_that_are_none(block):
    parameter = changed(block, parameters=(jb.blocks.Parameter("shift"),))
    assert refused(put(parameter, lambda b: b.parameters, jnp.array([jnp.nan]))) == [
        "parameter shift is not a finite number"
    ]
    group = block.groups[0]
    matrices = np.broadcast_to(np.eye(3) - 1.0, (len(group.values), 3, 3))
    wrong = eqx.tree_at(lambda g: g.covariances, group, jnp.asarray(matrices), is_leaf=lambda x: x is None)
    found = refused(dataclasses.replace(block, groups=(wrong, *block.groups[1:])))
    assert set(found) == {"the covariance matrix is not positive definite"}


ABSURD = {
    "points: the approximate coordinate 1e+300 is beyond 1e+12": (lambda b: b.object_points, (2, 1), 1e300),
    "images: the projection centre 1e+13": (lambda b: b.exterior.projection_centre, (1, 0), 1e13),
    "images: the angle 3600 deg makes more than 10 full turns": (lambda b: b.exterior.angles, (1, 2), 20.01 * np.pi),
    "rays: the standard deviation 1e-150 lies outside 1e-12": (lambda b: b.rays.sigmas, (4, 0), 1e-150),
    "cameras: the interior element 1e+300": (lambda b: b.interior.elements, (0, 0), 1e300),
}


@pytest.mark.parametrize("words", ABSURD)
def test_absurd_numbers(block, words):
    where, index, value = ABSURD[words]
    table, what = words.replace("3600 deg", "3601.8 deg").split(": ")
    (problem,) = jb.blocks.validate(put(block, where, where(block).at[index].set(value)))
    assert problem.table == table and problem.row == index[0] and problem.what.startswith(what)


def distances(block, kind, indices, values):
    """The block with geodetic observations between points."""
    values = np.array(values, float)[:, None]
    group = jb.observations.observation_group(
        jb.observations.geodetic_kind(kind), np.array(indices), values, np.full(values.shape, 0.01)
    )
    return dataclasses.replace(block, groups=(*block.groups, group))


@pytest.mark.parametrize("kind", ["azimuths", "distances", "zenith_angles"])
def test_lines_of_no_length(block, kind):
    """An azimuth of a vertical pair, and a distance between equal approximate values."""
    x = np.array(block.object_points)
    x[7] = x[3] if kind == "distances" else x[3] + [0, 0, 5]
    same = distances(put(block, lambda b: b.object_points, jnp.asarray(x)), kind, [[1, 2], [3, 7], [7, 3]], [1, 1, 1])
    (problem,) = jb.blocks.validate(same)
    names = block.structure.point_names
    assert problem.what.startswith(f"{names[3]} and {names[7]} have the same approximate")
    assert problem.what.endswith("and of 1 more rows") and (problem.table, problem.row) == (kind, 1)


def test_azimuths_of_many_turns(block):
    (problem,) = jb.blocks.validate(distances(block, "azimuths", [[1, 2]], [3_600_000_090 * np.pi / 180]))
    assert problem.what == "the angle 3600000090 deg makes more than 10 full turns"


def test_repeated_rows_are_told_and_adjusted(block):
    twice = distances(block, "distances", [[1, 2], [3, 4], [1, 2], [1, 2]], [5, 6, 5, 5])
    (found,) = repeated_rows(twice)
    assert found.kind is Kind.INFORMATION and found.size == 2 and "2 rows of distances repeat" in found.what
    assert not [p for p in jb.blocks.validate(twice) if p.table == "distances"]


def test_all_is_told_at_once(block):
    s = block.structure
    wrong = changed(block, ray_image=s.ray_image + 7, image_camera=s.image_camera - 1)
    wrong = put(wrong, lambda b: b.object_points, jnp.zeros(3))
    found = refused(wrong)
    assert len(found) == 3  # one line for each cause
    assert f"and {len(s.ray_image) - 1} more similar ones" in found[1]


JUNK = (
    *(None, 3, "x", [], {}, object(), ("a", "b", "c"), (None,), np.zeros(0), np.zeros((2, 2)), np.array(["a"])),
    *(np.full(3, 10**9), np.zeros(3, bool), np.array(1.0)),
)
PARTS = {
    "structure": lambda b, part: dataclasses.replace(b, structure=part),
    "exterior": lambda b, part: dataclasses.replace(b, exterior=part),
    "group": lambda b, part: dataclasses.replace(b, groups=(part,)),
    "members": lambda b, part: PARTS["group"](b, dataclasses.replace(b.groups[0], structure=part)),
    "kind": lambda b, part: PARTS["members"](b, dataclasses.replace(b.groups[0].structure, kind=part)),
    "camera": lambda b, part: PARTS["structure"](b, dataclasses.replace(b.structure, cameras=(part,))),
    "model": lambda b, part: PARTS["camera"](b, dataclasses.replace(b.structure.cameras[0], model=part)),
    "datum": lambda b, part: PARTS["structure"](b, dataclasses.replace(b.structure, datum=part)),
}
RIGHT = {
    "structure": lambda b: b.structure,
    "exterior": lambda b: b.exterior,
    "group": lambda b: b.groups[0],
    "members": lambda b: b.groups[0].structure,
    "kind": lambda b: b.groups[0].structure.kind,
    "camera": lambda b: b.structure.cameras[0],
    "model": lambda b: b.structure.cameras[0].model,
    "datum": lambda b: b.structure.datum,
}


@pytest.mark.parametrize("part", PARTS)
def test_anything_else_in_place_of_a_part(block, part):
    """No exception but a BlockError, whatever stands there; hardly anything of it is a block."""
    right = RIGHT[part](block)
    accepted = []
    for field in dataclasses.fields(right):
        for junk in JUNK if field.name != "structure" else (None, 3, "x", ("a",)):  # equinox warns of static arrays
            found = inconsistencies(PARTS[part](block, dataclasses.replace(right, **{field.name: junk})))
            assert not [str(problem) for problem in found if "\n" in str(problem)]
            accepted += [(field.name, junk)] if not found else []
    free = ("name", "table", "object_unit", "source", "findings", "inner_orientations", "width", "height")
    assert {name for name, _ in accepted} <= {
        *free,
        "in_object_system",
        "angles",
        "carriers",
        "covariances",
        "constraints",
        "image_names",
        "components",
    }


def test_a_traced_block_is_looked_at_too(block):
    wrong = changed(block, ray_image=block.structure.ray_image + 7)
    with pytest.raises(jb.BlockError, match="names image"):
        jax.jit(lambda points: jb.adjust(put(wrong, lambda b: b.object_points, points)).vtpv)(block.object_points)


def with_model(block, function, elements=BAL.elements):
    """The block with a camera model of the user's."""
    (camera,) = block.structure.cameras
    camera = dataclasses.replace(camera, model=jb.cameras.CameraModel("mine", elements, function))
    free = np.zeros((1, len(elements)), bool)
    block = changed(block, cameras=(camera,), interior_free=free)
    return put(block, lambda b: b.interior.elements, jnp.ones((1, len(elements))))


def projected(i, p, m):
    return -i[0] * p[0] / p[2] - m[0], -i[0] * p[1] / p[2] - m[1]


MODELS = {
    "fails with TypeError": lambda i, p: (p[0], p[1]),
    "returns 3 values, not 2 residuals": lambda i, p, m: (*projected(i, p, m), i[0]),
    "returns an array of shape (2,), not 2 residuals in a tuple": lambda i, p, m: jnp.stack(projected(i, p, m)),
    "returns a residual of shape (2,)": lambda i, p, m: (jnp.ones(2) * p[0], p[1]),
    "returns a residual of type bool": lambda i, p, m: (p[0] > 1, p[1]),
    "returns str among its residuals": lambda i, p, m: ("a", p[1]),
    "fails with TracerArrayConversionError": lambda i, p, m: (np.sqrt(np.asarray(p[0])), p[1]),
    "fails with TracerBoolConversionError": lambda i, p, m: (p[0] if p[0] > 0 else -p[0], p[1]),
    "fails with IndexError": lambda i, p, m: (i[7] * p[0], p[1]),
    "the residual is not a finite number": lambda i, p, m: (jnp.sqrt(-1.0 - p[2] ** 2), p[1]),
    "the derivative of the residual is not a finite number": lambda i, p, m: (jnp.sqrt(0 * p[0]) + m[0], m[1]),
}


@pytest.mark.parametrize("words", MODELS)
def test_camera_models(block, words):
    (found,) = refused(with_model(block, MODELS[words]))
    assert found.startswith("the camera model 'mine' of camera ") and words in found


def test_a_camera_without_model(block):
    (camera,) = block.structure.cameras
    (found,) = refused(changed(block, cameras=(dataclasses.replace(camera, model="brown"),)))
    assert "is of type str, not a CameraModel" in found
    assert "names an element twice" in refused(with_model(block, projected, ("c", "c")))[0]


KINDS = {
    "fails with TypeError": lambda p, q: (p[0],),
    "returns 2 values, not 1 residuals": lambda p, observed: (p[0] - observed[0], p[1]),
    "not 1 residuals in a tuple": lambda p, observed: p[0] - observed[0],
    "fails with IndexError": lambda p, observed: (p[3] - observed[0],),
}


@pytest.mark.parametrize("words", KINDS)
def test_kinds(block, words):
    residual = KINDS[words] if words != "fails with TypeError" else lambda p: (p[0],)
    kind = ObservationKind("heights", ("height",), ("point",), residual)
    group = jb.observations.observation_group(kind, np.array([[1]]), np.ones((1, 1)), np.ones((1, 1)))
    (found,) = refused(dataclasses.replace(block, groups=(*block.groups, group)))
    assert found.startswith("the residual of observations of kind 'heights' ") and words in found


def test_an_unknown_entity(block):
    kind = ObservationKind("heights", ("height",), ("points",), lambda p, o: (p[0],))
    group = jb.observations.observation_group(kind, np.array([[1]]), np.ones((1, 1)), np.ones((1, 1)))
    assert refused(dataclasses.replace(block, groups=(*block.groups, group))) == [
        "observations of kind heights touch 'points'"
    ]


def test_a_large_block_is_looked_at_quickly(block):
    """2.7 million rays of half a million points."""
    rays, points, images = 2_700_000, 540_000, 1200
    rng = np.random.default_rng(0)
    large = changed(
        block,
        image_names=tuple(map(str, range(images))),
        point_names=tuple(map(str, range(points))),
        image_camera=np.zeros(images, np.int32),
        ray_image=rng.integers(0, images, rays, dtype=np.int32),
        ray_point=np.sort(rng.integers(0, points, rays, dtype=np.int32)),
        exterior_free=np.ones((images, 6), bool),
        point_free=np.ones((points, 3), bool),
    )
    large = eqx.tree_at(
        lambda b: (b.exterior, b.object_points, b.rays),
        large,
        (
            jb.blocks.ExteriorOrientation(jnp.zeros((images, 3)), jnp.zeros((images, 3))),
            np.zeros((points, 3)),
            jb.blocks.Rays(jnp.zeros((rays, 2)), jnp.ones((rays, 2))),
        ),
    )
    start = time.process_time()
    assert inconsistencies(large) == []
    assert time.process_time() - start < 3.0  # 0.5 s where nothing else runs
