"""Markuze's criterion against cofactors of blocks whose control is without error, and the test that goes with it."""

import dataclasses
from functools import reduce
from operator import or_
from typing import NamedTuple

import equinox as eqx
import numpy as np
import pytest
from cases.all_observations import CASES, drawn, strip
from cases.dense_adjustment import centred, dense_system
from cases.six_photographs import true_block, with_sigmas
from jax import random

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.control_errors import NEGLIGIBLE, control_influence, influence
from jaxbundle.statistics.subsets import (
    Subset,
    all_control,
    control_point,
    image_coordinates,
    observations_of_kind,
    observed_points,
)

RAYS = 0.005  # mm


class Linear(NamedTuple):
    """A block's weighted design matrix and residuals, by other means, and the rows of a subset."""

    block: Block
    design: np.ndarray
    residuals: np.ndarray

    def rows(self, subset: Subset) -> np.ndarray:
        return np.concatenate([mask.T.ravel() for mask in subset.masks])

    def cofactors(self, errorless: np.ndarray) -> np.ndarray:
        """Of the unknowns, some observations made constraints: on the null space of their rows."""
        lengths = np.linalg.norm(self.design, axis=0)
        scaled = self.design / lengths
        _, size, vt = np.linalg.svd(scaled[errorless])
        free = vt[int((size > 1e-10 * size.max(initial=0.0)).sum()) :].T
        r = np.linalg.qr(scaled @ free, mode="r")
        root = free @ np.linalg.inv(r)
        return np.sum(root**2, 1) / lengths**2

    def vtpv(self, kept: np.ndarray) -> float:
        """At the minimum, of some observations."""
        lengths = np.linalg.norm(self.design, axis=0)
        step = np.linalg.lstsq((self.design / lengths)[kept], -self.residuals[kept], rcond=1e-12)[0]
        return float(np.sum((self.residuals + self.design @ (step / lengths))[kept] ** 2))


@pytest.fixture(scope="module")
def adjustment() -> Adjustment:
    """A strip with control, geodetic measurements between its points, and errors."""
    block = with_datum(CASES["geodetic"](strip(0.02)))
    return adjust(drawn(block, random.key(2)), precision=False)


@pytest.fixture(scope="module")
def linear(adjustment) -> Linear:
    system = dense_system(*centred(adjustment.block))
    return Linear(adjustment.block, system.design, system.residuals)


def subsets(block: Block) -> list[Subset]:
    names = observed_points(block)
    kinds = ("control", "distances", "directions")
    return [
        all_control(block),
        control_point(block, names[0]),
        control_point(block, names[0]) | control_point(block, names[-1]),
        *(observations_of_kind(block, kind) for kind in kinds),
        observations_of_kind(block, "control", "Z"),
    ]


def outside(tables, free) -> np.ndarray:
    """Numbers of a table of unknowns but attitudes, which the other system counts in small angles."""
    exterior = tables.exterior.T[:3][free.exterior_free.T[:3]]
    interior = tables.interior.T[free.interior_free.T]
    return np.concatenate(
        [exterior, interior, tables.parameters[free.parameter_free], tables.object_points.T[free.point_free.T]]
    )


@pytest.mark.parametrize("number", range(7))
def test_cofactors_with_and_without_errors(adjustment, linear, number):
    subset, structure = subsets(adjustment.block)[number], adjustment.block.structure
    found = influence(adjustment, subset)
    q, q0 = linear.cofactors(np.zeros(len(linear.design), bool)), linear.cofactors(linear.rows(subset))
    attitudes = np.zeros(structure.exterior_free.T.shape, bool)
    attitudes[3:] = True
    keep = np.ones(len(q), bool)
    keep[: structure.exterior_free.sum()] = ~attitudes[structure.exterior_free.T]
    np.testing.assert_allclose(outside(found.weighted, structure), q[keep], rtol=1e-8)
    mine = outside(found.errorless, structure)
    fixed = np.isnan(mine)
    np.testing.assert_allclose(mine[~fixed], q0[keep][~fixed], rtol=1e-7)
    assert (q0[keep][fixed] < 1e-12 * q[keep][fixed]).all()
    ratios = (q / np.where(q0 > 0, q0, 1) - 1)[keep][~fixed]
    np.testing.assert_allclose(outside(found.ratios, structure)[~fixed], ratios, rtol=1e-6, atol=1e-9)
    assert found.largest == np.nanmax([np.nanmax(table) for table in found.ratios if np.isfinite(table).any()])
    if subset.name == "control":
        free = structure.point_free[subset.masks[1].any(1).nonzero()[0]]
        assert fixed.sum() == free.sum() == subset.count


def test_held_control(adjustment):
    """Q0 of all orientations is what the same block has whose control is held; Q what it has with weights."""
    block = adjustment.block
    found = influence(adjustment, observations_of_kind(block, "control"))
    point_free = block.structure.point_free.copy()
    point_free[block.groups[0].structure.indices[:, 0]] = False
    structure = dataclasses.replace(block.structure, point_free=point_free)
    held = dataclasses.replace(block, structure=structure, groups=block.groups[1:])
    linear = dense_system(*centred(held)).design
    lengths = np.linalg.norm(linear, axis=0)
    q0 = np.sum(np.linalg.inv(np.linalg.qr(linear / lengths, mode="r")) ** 2, 1) / lengths**2
    np.testing.assert_allclose(
        found.errorless.exterior[:, :3].T.ravel(), q0[: 3 * len(found.errorless.exterior)], rtol=1e-7
    )


@pytest.mark.parametrize("number", range(7))
def test_residual_test_is_the_fall_of_vtpv(adjustment, linear, number):
    """Leaving the observations out; degrees are as many observations as the others control."""
    subset = subsets(adjustment.block)[number]
    rows = linear.rows(subset)
    test = influence(adjustment, subset).test
    left = linear.vtpv(~rows)
    assert test.statistic == pytest.approx(linear.vtpv(np.ones(len(rows), bool)) - left, rel=1e-6)
    rank = np.linalg.matrix_rank(linear.design[~rows] / np.linalg.norm(linear.design, axis=0), tol=1e-9)
    others = adjustment.n_observations - subset.count
    assert test.degrees == adjustment.redundancy - (others - rank)
    assert test.passed


def claimed(control: float, drawn_with: float, shift: float = 0.0) -> Adjustment:
    """Six photos and 12 control points, drawn with one sigma and claimed with another, the first moved in height."""
    block = drawn(with_sigmas(true_block(), RAYS, drawn_with), random.key(1))
    values = np.asarray(block.groups[0].values).copy()
    values[0, 2] += shift
    block = eqx.tree_at(lambda b: b.groups[0].values, with_sigmas(block, RAYS, control), values)
    return adjust(with_datum(block), precision=False)


def test_exact_control_may_be_errorless():
    found = control_influence(claimed(1e-4, 1e-4))
    assert found.test.passed and found.together.negligible and found.together.may_be_errorless
    assert found.errorless == tuple(p.control.name for p in sorted(found.points, key=lambda p: p.largest))
    assert len(found.errorless) == 12
    assert [influence.control.name for influence in found.kinds] == ["control"]
    assert "all control: negligible" in found.summary()


def test_weak_control_matters():
    found = control_influence(claimed(1.0, 1.0))
    assert not found.together.negligible and found.errorless == ()
    assert found.together.largest >= max(point.largest for point in found.points)
    assert "not negligible" in found.summary() and "May be regarded as errorless: none" in found.summary()


def test_a_part_may_be_errorless():
    """Each point alone is, all together are not: as many are taken as are so together."""
    adjustment = claimed(0.03, 0.03)
    found = control_influence(adjustment)
    singly = [point for point in found.points if point.may_be_errorless]
    assert not found.together.negligible and 1 < len(found.errorless) < len(singly)
    taken = [point for point in singly if point.control.name in found.errorless]
    together = influence(adjustment, reduce(or_, (point.control for point in taken)))
    assert together.negligible and together.largest > max(point.largest for point in taken)


def test_wrong_control_is_claimed_exact():
    """It passes the criterion and fails the test of its residuals, by far the worst of all."""
    found = control_influence(claimed(1e-4, 1e-4, shift=0.3))
    first, *others = found.points
    assert first.negligible and not first.test.passed and not first.may_be_errorless
    assert first.test.statistic > max(point.test.statistic for point in others)
    assert not found.test.passed and found.errorless == ()
    assert "its residuals contradict its sigmas" in str(first)
    assert "some sigmas are too small" in found.summary()


@pytest.mark.usefixtures("unchecked_types")  # wrong types on purpose
def test_refusals(adjustment):
    block = adjustment.block
    with pytest.raises(ValueError, match="control means observations other than image coordinates"):
        influence(adjustment, image_coordinates(block))
    with pytest.raises(ValueError, match="nothing: control means"):
        influence(adjustment, Subset("nothing", tuple(mask & False for mask in all_control(block).masks)))
    held = dataclasses.replace(
        block, structure=dataclasses.replace(block.structure, point_free=block.structure.point_free & False), groups=()
    )
    with pytest.raises(ValueError, match="no control with sigmas"):
        control_influence(eqx.tree_at(lambda a: a.block, adjustment, held))
    assert NEGLIGIBLE == 0.11
