"""Rays of tracks on images with known shifts between them; the pairs that may overlap."""

import numpy as np
import pytest
from cases.images_in_memory import in_memory
from cases.textures import Waves

from jaxbundle.imagery.interest_points import Features
from jaxbundle.imagery.match_types import Refusal
from jaxbundle.imagery.tracks import tracks
from jaxbundle.imagery.windows import GreyImages
from jaxbundle.measuring import verify
from jaxbundle.measuring.measured_rays import measured_rays
from jaxbundle.measuring.verify import NEIGHBOURS, View, neighbours, verified_pairs

SHIFTS = np.array([[0.0, 0.0], [20.3, -5.6], [-11.8, 31.4]])
SIZE, NOISE = 260, 0.5


def test_rays_of_three_shifted_images():
    waves, rng = Waves(11), np.random.default_rng(12)
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    images = [waves(x + dx, y + dy) + NOISE * rng.standard_normal(x.shape) for dx, dy in SHIFTS]
    images[2][60:130, 60:130] = rng.uniform(0, 255, (70, 70))  # something that the others do not see
    ground = np.stack(np.meshgrid(np.arange(50.0, 215, 12), np.arange(50.0, 215, 12)), -1).reshape(-1, 2)
    features = [ground - shift + rng.uniform(-0.7, 0.7, ground.shape) for shift in SHIFTS]
    same = np.stack([np.arange(len(ground))] * 2, 1)
    found = tracks([len(ground)] * 3, {(0, 1): same, (1, 2): same})
    rays = measured_rays(GreyImages({k: in_memory(g) for k, g in enumerate(images)}), found, features, 0)
    assert rays.refused[Refusal.LOW_CORRELATION] + rays.refused[Refusal.NOT_CONVERGED] > 5
    assert len(rays.image) > 0.7 * 3 * len(ground)
    assert np.bincount(rays.point).min() >= 2
    terrain = rays.xy + SHIFTS[rays.image]  # of one point the same from all images
    first = np.r_[True, np.diff(rays.point) > 0]
    errors = (terrain - terrain[first][np.cumsum(first) - 1])[~first]
    assert np.median(np.abs(errors)) < 0.02
    assert rays.sigmas.min() >= 0.02
    assert (np.abs(errors) < 5 * np.maximum(rays.sigmas[~first], 0.02)).mean() > 0.97


def test_pairs_of_near_stations():
    nothing = Features(np.zeros((0, 2)), np.zeros((0, 128)))
    stations = np.array([[60.0 * (k % 6), 40.0 * (k // 6), 100.0] for k in range(18)])
    views = [View(nothing, np.zeros(5), station) for station in stations]
    pairs = neighbours(views)
    assert len(pairs) < 18 * 17 / 2
    assert all(i < j for i, j in pairs)
    assert np.bincount(np.ravel(pairs)).min() >= NEIGHBOURS
    assert (0, 1) in pairs and (0, 17) not in pairs
    assert len(neighbours([*views[:17], views[17]._replace(station=None)])) == 18 * 17 / 2


def test_finished_pairs_are_found_again(tmp_path, monkeypatch):
    rng, tried = np.random.default_rng(1), []

    def fails_at(number):
        def verified(first, second, sigma):
            if len(tried) == number:
                raise KeyboardInterrupt
            tried.append((first.name, second.name))
            return np.zeros((0, 2), int) if second.name == "c" else np.array([[1, 2], [3, 4]])

        return verified

    views = [View(Features(rng.uniform(size=(5, 2)), rng.uniform(size=(5, 128))), np.ones(5), None, n) for n in "abc"]
    monkeypatch.setattr(verify, "verified", fails_at(2))
    with pytest.raises(KeyboardInterrupt):
        verified_pairs(views, 2.0, folder=tmp_path / "pairs")
    monkeypatch.setattr(verify, "verified", fails_at(-1))
    found = verified_pairs(views, 2.0, folder=tmp_path / "pairs")
    assert tried == [("a", "b"), ("a", "c"), ("b", "c")]  # none of them twice
    assert {key: matches.tolist() for key, matches in found.items()} == {(0, 1): [[1, 2], [3, 4]]}
    moved = views[1]._replace(features=views[1].features._replace(xy=views[1].features.xy + 1))
    (tmp_path / "pairs" / "a+c.npz").write_bytes(b"cut")
    verified_pairs([views[0], moved, views[2]], 2.0, folder=tmp_path / "pairs")
    assert tried[3:] == [("a", "b"), ("a", "c"), ("b", "c")]  # other points of b; a damaged file
