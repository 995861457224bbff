"""Marks of control points in photographs: read from a list, remeasured, written with the block."""

import numpy as np
import pytest
from cases.images_in_memory import in_memory
from cases.textures import Waves

import jaxbundle as jb
from jaxbundle.imagery.match_types import Refusal
from jaxbundle.imagery.windows import GreyImages
from jaxbundle.io.formats.ground_control import read_control
from jaxbundle.measuring.control_marks import BY_HAND, marks_of, remeasured
from jaxbundle.measuring.measured_rays import MeasuredRays

SHIFTS = np.array([[0.0, 0.0], [20.3, -5.6], [-11.8, 31.4]])
SIZE, NOISE, CLICK = 260, 0.5, 0.8
GROUND = np.array([[100.0, 120.0], [150.0, 140.0], [130.0, 90.0], [160.0, 110.0]])
NAMES = ["a.jpg", "b.jpg", "c.jpg"]


@pytest.fixture
def listed(tmp_path):
    """A list with three marks of each point, wrong by a pixel; the last mark lies in another photograph."""
    rng = np.random.default_rng(3)
    rows = ["+proj=utm +zone=11 +ellps=WGS84 +datum=WGS84 +units=m +no_defs"]
    for k, ground in enumerate(GROUND):
        for name, shift in zip(NAMES, SHIFTS, strict=True):
            u, v = ground - shift + CLICK * rng.standard_normal(2) - 0.5
            rows.append(f"{500 + 10 * k} {700 + k} 20 {u} {v} {name.upper()} g{k}")
    (tmp_path / "gcp_list.txt").write_text("\n".join([*rows, "500 700 20 10 10 other.jpg g0"]) + "\n")
    return read_control(tmp_path / "gcp_list.txt")


def test_marks_of_a_list(listed):
    marks = marks_of(listed, NAMES)
    assert [point.name for point in marks.points] == ["g0", "g1", "g2", "g3"]
    assert marks.image.tolist() == [0, 1, 2] * 4 and (marks.status == BY_HAND).all()
    assert "1 of 13 marks of control are in other photographs" in [finding.what for finding in marks.findings]
    with pytest.raises(jb.BlockError, match="none of its 13 marks is in one of the photographs"):
        marks_of(listed, ["x.jpg"])


def test_marks_measured_again(listed):
    """The matches agree within hundredths of a pixel, and their common error is that of the mean of three marks."""
    waves, rng = Waves(11), np.random.default_rng(12)
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    images = [waves(x + dx, y + dy) + NOISE * rng.standard_normal(x.shape) for dx, dy in SHIFTS]
    images[2][64:92, 159:186] = rng.uniform(0, 255, (28, 27))  # covers the last point
    tie = rng.uniform(60, 200, (20, 2))
    rays = MeasuredRays(
        np.repeat(np.arange(3), 20),
        np.tile(np.arange(20), 3),
        np.concatenate([tie - shift for shift in SHIFTS]),
        np.full((60, 2), 0.1),
        {},
    )
    marks = marks_of(listed, NAMES)
    found = remeasured(GreyImages({k: in_memory(g, 2) for k, g in enumerate(images)}), marks, rays, [(SIZE, SIZE)] * 3)
    status = found.status.reshape(4, 3)
    assert (status[:3] == Refusal.MATCHED).all() and status[3, 2] not in (Refusal.MATCHED, BY_HAND)
    np.testing.assert_array_equal(found.xy[11], marks.xy[11])
    ground = (found.xy + SHIFTS[found.image]).reshape(4, 3, 2)[:3]
    by_hand = (marks.xy + SHIFTS[marks.image]).reshape(4, 3, 2)[:3]
    assert np.abs(ground - ground.mean(1, keepdims=True)).max() < 0.03
    np.testing.assert_allclose(ground.mean(1), by_hand.mean(1), atol=0.02)
    assert "11 of 12 marks of control were remeasured by matching" in found.findings[-1].what
