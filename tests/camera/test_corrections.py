"""Refraction and earth curvature against rays traced through an atmosphere and against a sphere."""

from pathlib import Path

import numpy as np
import pytest
from cases.camera_definitions import INTERIORS, MEASURED, PHOTO_VECTOR, computed
from cases.small_folder import change, make_small_folder

from jaxbundle.block.problems import BlockError
from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.camera.camera_models import CAMERA_MODELS, named_model
from jaxbundle.camera.corrections import EARTH_RADIUS, curvature_coefficient, refraction_coefficient, with_corrections
from jaxbundle.io import read_block_folder, write_block_folder

C = 153.0


def refractive_index(height):
    """n by height in m: standard atmosphere below 11 km (ISO 2533), n - 1 = 2.26e-4 m3/kg density (Schut 1969)."""
    temperature = 288.15 - 6.5e-3 * height
    pressure = 101325.0 * (temperature / 288.15) ** (9.80665 / 287.05287 / 6.5e-3)
    return 1 + 2.26e-4 * pressure / 287.05287 / temperature


def traced(flying_height, ground_height, zenith):
    """Distance on the ground of a ray that arrives at the camera under this angle: n sin z is the same all along."""
    heights = np.linspace(ground_height, flying_height, 20_001)
    n = refractive_index(heights)
    sine = n[-1] * np.sin(zenith) / n
    return np.trapezoid(sine / np.sqrt(1 - sine**2), heights), np.mean((n[1:] + n[:-1]) / 2) - n[-1]


def radius(distance, height, refraction=0.0, earth_curvature=0.0):
    """Image radius of a point at this distance from the nadir, this far below the camera."""
    model = with_corrections(DISTORTION_FREE)
    interior = (C, 0.0, 0.0, 1.0, 1.0, refraction, earth_curvature)
    return computed(model, interior, (distance, 0.0, -height), (0.0, 0.0))[0]


# The correction


@pytest.mark.parametrize("degrees", [1, 20, 45, 60])
@pytest.mark.parametrize("heights", [(500, 0), (3000, 1000), (9000, 300)])
def test_refraction_is_that_of_a_traced_ray(heights, degrees):
    """Outwards by K (r + r^3 / c^2), up to the square of K."""
    zenith = np.radians(degrees)
    distance, K = traced(heights[0], heights[1], zenith)
    height, apparent = heights[0] - heights[1], C * np.tan(zenith)
    assert apparent > radius(distance, height)
    dr = K * (apparent + apparent**3 / C**2)
    assert apparent - radius(distance, height) == pytest.approx(dr, rel=1e-3)
    assert radius(distance, height, refraction=K) == pytest.approx(apparent, abs=1e-3 * dr)


@pytest.mark.parametrize("tangent", [0.1, 0.5, 1.0, 1.5])
@pytest.mark.parametrize("height", [1000.0, 9000.0])
def test_earth_curvature_is_that_of_a_sphere(height, tangent):
    """Inwards by H r^3 / (2 R c^2), up to its square: a point at the arc D from the nadir, seen from the height H."""
    arc = tangent * height
    angle = arc / EARTH_RADIUS
    true = C * EARTH_RADIUS * np.sin(angle) / (height + EARTH_RADIUS * (1 - np.cos(angle)))
    r = C * tangent
    dr = height * r**3 / (2 * EARTH_RADIUS * C**2)
    assert r - true == pytest.approx(dr, rel=3 * tangent**2 * height / EARTH_RADIUS + 1e-3)
    E = curvature_coefficient(height + 250.0, 250.0)
    assert radius(arc, height, earth_curvature=E) == pytest.approx(true, abs=2 * dr**2 / r + 1e-3 * dr)


@pytest.mark.parametrize("name", CAMERA_MODELS)
def test_any_model_is_corrected_in_its_photo_vector(name):
    model = with_corrections(CAMERA_MODELS[name])
    px, py, pz = PHOTO_VECTOR
    K, E = 3e-5, 2e-4
    t2 = (px**2 + py**2) / pz**2
    factor = 1 + K * (1 + t2) - E * t2
    expected = computed(CAMERA_MODELS[name], INTERIORS[name], (factor * px, factor * py, pz), MEASURED[name])
    found = computed(model, (*INTERIORS[name], K, E), PHOTO_VECTOR, MEASURED[name])
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    assert model.elements[-2:] == ("refraction", "earth_curvature")
    assert model.estimable == CAMERA_MODELS[name].estimable
    assert with_corrections(CAMERA_MODELS[name]) is model and named_model(model) is CAMERA_MODELS[name]


# The coefficients


def test_refraction_coefficient_is_bertrams():
    """By hand: 0.00241 6 / 250 = 57.84e-6 at 6 km above ground at sea level; less 0.00241 2 / 242 / 3 over 2 km."""
    assert refraction_coefficient(6000.0, 0.0) == pytest.approx(57.84e-6, rel=1e-12)
    assert refraction_coefficient(6000.0, 2000.0) == pytest.approx(57.84e-6 - 0.00241 * 2 / 242 / 3, rel=1e-12)
    assert refraction_coefficient(1000.0, -100.0) > refraction_coefficient(1000.0, 0.0) - 1e-6


@pytest.mark.parametrize("height, found", [(1000, 9.8), (3000, 30.0), (6000, 57.8), (9000, 78.3)])
def test_refraction_coefficient_is_near_that_of_the_standard_atmosphere(height, found):
    assert refraction_coefficient(height, 0.0) == pytest.approx(found * 1e-6, abs=0.05e-6)
    assert refraction_coefficient(height, 0.0) == pytest.approx(traced(height, 0, 0.0)[1], abs=5e-6)


def test_curvature_of_a_wide_angle_photograph():
    """H = 4 km, r = c = 150 mm: H r^3 / (2 R c^2) = 4 km / 12742 km 150 mm = 47 micrometres."""
    assert curvature_coefficient(4300.0, 300.0) * 150.0 == pytest.approx(0.0471, abs=5e-5)


@pytest.mark.parametrize(
    "heights, words",
    [
        ((500.0, 500.0), "flying_height 500.0 is not above ground_height 500.0"),
        ((-10.0, -50.0), "flying_height -10.0 is not above sea level"),
        ((2.5e6, 0.0), "flying_height 2500000.0 is above the atmosphere"),
        ((float("nan"), 0.0), "flying_height nan and ground_height 0.0 are not finite numbers"),
    ],
)
@pytest.mark.parametrize("coefficient", [refraction_coefficient, curvature_coefficient])
def test_heights_that_are_none(coefficient, heights, words):
    with pytest.raises(ValueError, match=words):
        coefficient(*heights)


# block.toml


def folder_with(path: Path, corrections: str) -> Path:
    folder = make_small_folder(path)
    change(folder, "block.toml", 20, "estimate = []", f"estimate = []\ncorrections = {corrections}")
    return folder


def test_corrections_are_read_and_written(tmp_path: Path) -> None:
    heights = "flying_height = 2500.0, ground_height = 200"
    block = read_block_folder(
        folder_with(tmp_path / "a", f"{{ {heights}, refraction = true, earth_curvature = true }}")
    )
    K, E = refraction_coefficient(2500.0, 200.0), curvature_coefficient(2500.0, 200.0)
    assert block.structure.model is with_corrections(DISTORTION_FREE)
    np.testing.assert_array_equal(block.interior.elements[0, -2:], [K, E])
    assert not block.structure.interior_free.any()
    write_block_folder(block, tmp_path / "b")
    again = read_block_folder(tmp_path / "b")
    np.testing.assert_array_equal(again.interior.elements, block.interior.elements)
    assert again.structure.model is block.structure.model
    one = read_block_folder(folder_with(tmp_path / "c", "{ refraction = 3.1e-5 }"))
    np.testing.assert_array_equal(one.interior.elements[0, -2:], [3.1e-5, 0.0])


HEIGHTS = "give both heights in m above sea level"


@pytest.mark.parametrize(
    "corrections, words",
    [
        (
            "{ flying_height = 2500.0, refraction = true }",
            "refraction = true needs the heights of the flight and of the ground; "
            "give flying_height and ground_height in m above sea level",
        ),
        (
            "{ flying_height = 200.0, ground_height = 2500.0, earth_curvature = true }",
            f"earth_curvature: flying_height 200.0 is not above ground_height 2500.0; {HEIGHTS}",
        ),
        (
            "{ flying_height = 2.5e6, ground_height = 0.0, refraction = true }",
            f"refraction: flying_height 2500000.0 is above the atmosphere; {HEIGHTS}",
        ),
        (
            "{ flying_height = 2500.0, ground_height = 0.0 }",
            "corrections are neither refraction nor earth_curvature; set one of them to true, or drop the section",
        ),
        ("{ refraction = 24.5 }", "refraction is 24.5; give true, false or a coefficient from 0 to 0.001"),
        ('{ earth_curvature = "yes" }', "earth_curvature is 'yes'; give true, false or a coefficient from 0 to 0.01"),
        ("{ refraction = -1e-5 }", "refraction is -1e-05; give true, false or a coefficient from 0 to 0.001"),
        (
            "{ height = 2500.0, refraction = 1e-5 }",
            "height is unknown; known keys: flying_height, ground_height, refraction, earth_curvature",
        ),
        (
            '{ flying_height = "high", refraction = 1e-5 }',
            'flying_height is "high"; give a number, without quotes and without unit',
        ),
    ],
)
def test_nonsense_is_told(tmp_path: Path, corrections: str, words: str) -> None:
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder_with(tmp_path / "small", corrections))
    assert list(caught.value.lines) == [f"block.toml:21: [cameras.wide] {words}"]
