"""Points spread over the image, candidates of pairs, tracks over all images, affine maps of neighbours."""

import numpy as np
import pytest
from PIL import Image

import jaxbundle as jb
from jaxbundle.imagery.exif import exif_of
from jaxbundle.imagery.interest_points import empty_places, features, kept_features, spread
from jaxbundle.imagery.match_candidates import candidates
from jaxbundle.imagery.tracks import local_affine, tracks
from jaxbundle.imagery.window_pairs import levels_of


def test_points_fill_all_places():
    rng = np.random.default_rng(1)
    xy = np.concatenate([rng.uniform(0, 10, (900, 2)), rng.uniform(0, 80, (300, 2))])
    strength = np.concatenate([rng.uniform(5, 6, 900), rng.uniform(0, 1, 300)])  # one corner is much stronger
    chosen = spread(xy, strength, (80, 80), 128)
    assert len(chosen) == 128
    counts = np.histogram2d(*xy[chosen].T, bins=8, range=[[0, 80], [0, 80]])[0]
    assert counts.min() >= 1
    assert counts.max() <= 3
    assert empty_places(xy[chosen], 80, 80) == 0
    assert empty_places(np.array([[1.0, 1.0], [70.0, 70.0]]), 80, 80) == 7


def test_one_point_of_several_at_one_position():
    xy = np.array([[5.0, 5.0], [5.0, 5.0], [7.0, 7.0]])
    assert sorted(spread(xy, np.array([1.0, 2.0, 0.5]), (10, 10), 10)) == [1, 2]


def test_candidates_are_mutual_and_clear():
    rng = np.random.default_rng(2)
    first = rng.standard_normal((50, 128))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    order = rng.permutation(50)
    second = first[order] + 0.01 * rng.standard_normal((50, 128))
    second = np.concatenate([second, second[:1] + 1e-6])  # its first one is there twice: not clear
    pairs = candidates(first, second / np.linalg.norm(second, axis=1, keepdims=True))
    assert len(pairs) == 49
    assert (order[pairs[:, 1]] == pairs[:, 0]).all()
    assert len(candidates(first[:1], second)) == 0


def test_tracks_join_all_images_and_drop_contradictions():
    pairs = {
        (0, 1): np.array([[0, 0], [1, 1], [2, 2]]),
        (1, 2): np.array([[0, 0], [1, 1]]),
        (0, 2): np.array([[0, 0], [3, 1]]),  # features 1 and 3 of image 0 would be one point
    }
    found = tracks([4, 3, 2], pairs)
    rays = sorted(zip(found.point.tolist(), found.image.tolist(), found.feature.tolist(), strict=True))
    assert rays == [(0, 0, 0), (0, 1, 0), (0, 2, 0), (1, 0, 2), (1, 1, 2)]
    assert len(tracks([0, 0], {}).image) == 0


def test_affine_map_of_neighbours():
    rng = np.random.default_rng(3)
    a = np.array([[0.9, -0.3], [0.2, 1.1]])
    first = rng.uniform(0, 100, (40, 2))
    found = local_affine(first, first @ a.T + 5, np.array([[50.0, 50.0], [10.0, 90.0]]))
    np.testing.assert_allclose(found, [a, a], rtol=1e-6)
    assert np.isnan(local_affine(first[:5], first[:5], np.zeros((1, 2)))).all()


def test_levels_of_unlike_scales():
    scales = np.array([1.0, 1.3, 2.1, 0.45, np.nan])[:, None, None] * np.eye(2)
    template, image = levels_of(scales, 1)
    assert template.tolist() == [1, 1, 1, 2, 1]
    assert image.tolist() == [1, 1, 2, 1, 1]


def test_points_of_an_image_turned_by_half_a_turn_are_the_same(shared_data, tmp_path):
    """No bias: a detector that is off by a part of a pixel is off the other way in the turned image."""
    picture = Image.open(shared_data / "images" / "brighton" / "DJI_0020.jpg").convert("L").crop((400, 300, 1040, 780))
    picture.save(tmp_path / "a.png")
    picture.rotate(180).save(tmp_path / "b.png")
    one, other = (features(jb.imagery.pyramid(tmp_path / f"{name}.png"), 0, 400) for name in "ab")
    pairs = candidates(one.descriptors, other.descriptors)
    assert len(pairs) > 200
    difference = one.xy[pairs[:, 0]] - ([640.0, 480.0] - other.xy[pairs[:, 1]])
    assert np.abs(np.median(difference, 0)).max() < 0.01
    made = jb.imagery.pyramid(tmp_path / "a.png")
    first, again = kept_features(made, 0, 400), kept_features(made, 0, 400)
    np.testing.assert_array_equal(first.xy, one.xy)
    np.testing.assert_array_equal(again.descriptors, first.descriptors)
    assert len(kept_features(made, 0, 100).xy) == 100


def test_exif_of_a_photograph(tmp_path):
    image, exif = Image.new("L", (40, 30)), Image.Exif()
    exif[271], exif[272] = "DJI", "FC300S"
    exif.get_ifd(0x8769)[37386] = 3.61
    gps = exif.get_ifd(0x8825)
    gps.update({1: "N", 2: (46.0, 50.0, 33.0), 3: "W", 4: (91.0, 59.0, 42.0), 5: b"\x00", 6: 198.5})
    image.save(tmp_path / "a.jpg", exif=exif)
    found = exif_of(tmp_path / "a.jpg")
    assert found.camera == "DJI FC300S"
    assert found.focal == pytest.approx(3.61)
    assert found.station == pytest.approx((46.8425, -91.995, 198.5))
    Image.new("L", (40, 30)).save(tmp_path / "b.png")
    assert exif_of(tmp_path / "b.png").station is None
