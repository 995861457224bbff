"""Strips and blocks of the literature: laws of the free end and of tied strips, blocks by control, GNSS blocks of 1992.

Values are standard deviations in sigma0 times the scale number, computed once by an independent program; those of
Ackermann (1992, ISPRS XVII, table 1) are published.
"""

import numpy as np
import pytest
from cases.dense_covariance import dense_deviations
from cases.schematic_flights import (
    PERIMETERS,
    UNIT,
    block_plan,
    free_end,
    gnss_plan,
    heights,
    heights_at,
    precision_of,
    tied_middle,
)

from jaxbundle.textbook.accuracy_laws import FREE_END_VARIANCES, bundle_free_end

BASES = (5, 10, 20, 40, 60)


@pytest.fixture(scope="module")
def free_ends():
    return {n: free_end(n) for n in BASES}


def test_free_end_of_ten_bases():
    found = free_end(10)
    assert found == pytest.approx([26.52, 20.81, 48.68], rel=1e-3)
    assert found == pytest.approx(bundle_free_end(10), rel=2e-3)


@pytest.mark.thorough
def test_free_end_of_twenty_bases(free_ends):
    assert free_ends[20] == pytest.approx([82.1, 65.4, 142.9], rel=2e-3)


@pytest.mark.thorough
def test_exponent_of_the_free_end(free_ends):
    n = np.array([20, 40, 60])
    deviations = np.array([free_ends[k] for k in n])
    exponents = np.polyfit(np.log(n), np.log(deviations), 1)[0]
    assert exponents == pytest.approx([1.552, 1.566, 1.524], abs=0.02)
    assert np.abs(exponents - 1.5).max() < 0.07


@pytest.mark.thorough
def test_free_end_is_a_cubic(free_ends):
    n = np.array(BASES, float)
    variances, powers = np.array([free_ends[k] for k in BASES]) ** 2, np.c_[n**3, n**2, n]
    for axis, known in enumerate(FREE_END_VARIANCES[60]):
        weights = 1 / variances[:, axis]
        fitted = np.linalg.lstsq(powers * weights[:, None], np.ones(len(n)), rcond=None)[0]
        assert fitted[0] == pytest.approx(known[0], rel=0.01)
        assert np.abs(np.sqrt(powers @ fitted * weights) - 1).max() < 3e-3


@pytest.mark.thorough
def test_tied_strip(free_ends):
    """Pairs across the ends clamp X and Y, 1/8, and hinge Z, 1/4; single points hinge all."""
    pairs, single = (tied_middle(40, pairs) / free_ends[40] for pairs in (True, False))
    assert pairs == pytest.approx([0.130, 0.134, 0.256], rel=0.02)
    assert pairs == pytest.approx([1 / 8, 1 / 8, 1 / 4], rel=0.1)
    assert single == pytest.approx([0.261, 0.264, 0.256], rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "expected"), [("P1", 0.84), ("P2", 0.90), ("P3", 1.18), ("P4", 2.56)])
def test_planimetry_of_blocks_by_their_perimeter(name, expected):
    chains = heights_at((0, 4, 8, 10), strips=5)
    assert precision_of(block_plan(5, 11, (PERIMETERS[name], chains))).rms_xy == pytest.approx(expected, rel=0.02)


@pytest.mark.thorough
def test_heights_between_chains_grow_with_their_distance():
    found = {i: precision_of(block_plan(5, 11, (PERIMETERS["P1"], heights(i)))).rms[1] for i in (2, 5, 10)}
    assert found[5] == pytest.approx(2.36, rel=0.02) and found[10] == pytest.approx(4.75, rel=0.02)
    assert (found[10] - found[2]) / 8 == pytest.approx(0.38, abs=0.01)


GNSS_BLOCKS = [
    ("c", "none", (1.0, 1.5), (0.98, 1.58)),
    ("a", "none", (1.0, 1.6), (0.94, 1.54)),
    ("c", "block", (1.7, 2.3), (1.68, 2.29)),
    ("a", "block", (1.7, 1.7), (1.55, 1.70)),
    ("a", "strip", (2.1, 2.3), (2.02, 2.27)),
    ("b", "strip", (1.5, 2.0), (1.53, 2.23)),
    ("a", "absent", None, (4.57, 11.96)),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("control", "systematic", "published", "computed"), GNSS_BLOCKS)
def test_gnss_blocks_of_1992(control, systematic, published, computed):
    found = precision_of(gnss_plan(control, systematic))
    assert found.rms == pytest.approx(computed, rel=0.01, abs=5e-3)
    if published:
        assert found.rms == pytest.approx(published, rel=0.12)
    dense = dense_deviations(found.block, UNIT)
    free = found.block.structure.point_free
    assert found.deviations[free] == pytest.approx(dense[free], rel=1e-5)
