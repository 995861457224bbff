"""Everything that can be found about an adjustment, provoked once: kind, severity, culprits, and each sentence."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Parameter
from jaxbundle.block.findings import Finding, Kind, Severity, Subject, in_order
from jaxbundle.block.navigation import ATTITUDES
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.diagnosis.boresight import boresight_findings
from jaxbundle.diagnosis.elements import _together, correlations_of
from jaxbundle.diagnosis.flying_heights import flying_height_findings
from jaxbundle.diagnosis.sigmas import global_test, group_factors
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.verdict import with_verdict
from jaxbundle.statistics.reliability_tables import redundancy_numbers
from jaxbundle.statistics.significance import insignificant


@pytest.fixture(scope="module")
def adjustment() -> Adjustment:
    return adjust(small_block().block)


def found(adjustment: Adjustment, kind: Kind) -> list[Finding]:
    return [finding for finding in findings(adjustment) if finding.kind is kind]


def judged(adjustment: Adjustment) -> Adjustment:
    """With a verdict of its own, not the one it had before it was changed."""
    return with_verdict(dataclasses.replace(adjustment, findings=()))


def with_structure(adjustment: Adjustment, **changes) -> Adjustment:
    structure = dataclasses.replace(adjustment.block.structure, **changes)
    return dataclasses.replace(adjustment, block=dataclasses.replace(adjustment.block, structure=structure))


def with_rays(adjustment: Adjustment, normalised: np.ndarray) -> Adjustment:
    rest = adjustment.weighted_residuals[1:]
    return dataclasses.replace(adjustment, weighted_residuals=(jnp.asarray(normalised), *rest))


def test_a_clean_block_is_trusted(adjustment):
    assert adjustment.trustworthy and adjustment.failures == () and adjustment.verdict == "converged"
    told = {finding.kind for finding in findings(adjustment)}
    assert told <= {Kind.INSIGNIFICANT, Kind.UNCONTROLLED, Kind.CORRELATED}


def test_order_is_by_severity_then_by_cause():
    note, check, failed = (Finding(k, "x") for k in (Kind.UNUSED, Kind.SUSPECT, Kind.UNDETERMINED))
    cause = Finding(Kind.FORMAT, "y")
    assert in_order([note, check, failed, cause, note]) == (cause, failed, check, note)
    assert [f.severity.label for f in (failed, check, note)] == ["failed", "check", "note"]
    assert Finding(Kind.BEHIND, "z", grade=Severity.NOTE).severity is Severity.NOTE


@pytest.mark.parametrize("status", [status for status in Status if status is not Status.CONVERGED])
def test_not_converged(adjustment, status):
    ended = judged(
        dataclasses.replace(adjustment, iterations=adjustment.iterations._replace(status=jnp.asarray(int(status))))
    )
    first = findings(ended)[0]
    assert first.kind is Kind.NOT_CONVERGED and first.what == f"the adjustment {status.words}" and first.cure
    assert not ended.trustworthy and not found(ended, Kind.GLOBAL_TEST)


def test_converged_never_stands_alone_where_the_result_must_not_be_used(adjustment):
    loose = dataclasses.replace(adjustment, findings=(Finding(Kind.UNDETERMINED, "point 7", "measure it"),))
    assert not loose.trustworthy and loose.undetermined == loose.findings
    assert "The adjustment converged, but its result must not be used: undetermined unknowns" in loose.summary()
    assert "Failed: point 7; measure it" in loose.summary()


def mirrored(adjustment: Adjustment) -> Adjustment:
    """Every camera on the other side of its points, looking away from them."""
    points = adjustment.block.object_points
    centre = adjustment.block.exterior.projection_centre
    ground = jnp.mean(points[:, 2])
    below = centre.at[:, 2].set(2 * ground - centre[:, 2])
    return judged(eqx.tree_at(lambda a: a.block.exterior.projection_centre, adjustment, below))


def test_a_mirrored_solution_is_not_trusted(adjustment):
    wrong = mirrored(adjustment)
    rays = len(adjustment.block.structure.ray_image)
    (sides,) = found(wrong, Kind.MIRRORED)
    assert not wrong.trustworthy and sides.size == rays
    assert sides.what == f"the solution is mirrored: all {rays} rays have their point behind the camera"
    (below,) = found(wrong, Kind.BELOW_TERRAIN)
    assert len(below.subjects) == len(adjustment.block.structure.image_names) and below.unit == "m"
    assert not found(wrong, Kind.GLOBAL_TEST)


def test_a_single_point_behind_is_named(adjustment):
    structure = adjustment.block.structure
    point = int(np.argmin(np.bincount(structure.ray_point)))
    above = adjustment.block.object_points.at[point, 2].add(1e5)
    wrong = judged(eqx.tree_at(lambda a: a.block.object_points, adjustment, above))
    (sides,) = found(wrong, Kind.BEHIND)
    assert sides.severity is Severity.CHECK and sides.subjects == (Subject("points", (structure.point_names[point],)),)


def test_images_with_points_behind_are_named(adjustment):
    centre = adjustment.block.exterior.projection_centre.at[3, 2].add(-5000.0)
    wrong = judged(eqx.tree_at(lambda a: a.block.exterior.projection_centre, adjustment, centre))
    (sides,) = found(wrong, Kind.BEHIND)
    assert sides.severity is Severity.FAILED and not wrong.trustworthy
    assert sides.subjects == (Subject("images", (adjustment.block.structure.image_names[3],)),)


def test_sigma0_beyond_use(adjustment):
    large = judged(
        dataclasses.replace(adjustment, weighted_residuals=tuple(30 * v for v in adjustment.weighted_residuals))
    )
    (sentence,) = found(large, Kind.SIGMA0)
    assert not large.trustworthy and sentence.size == pytest.approx(30 * float(adjustment.sigma0))


@pytest.mark.parametrize(("factor", "verdict"), [(1.5, "less"), (0.5, "more")])
def test_sigma0_outside_its_limits(adjustment, factor, verdict):
    scaled = dataclasses.replace(
        adjustment, weighted_residuals=tuple(factor * v for v in adjustment.weighted_residuals)
    )
    test = global_test(float(scaled.sigma0), scaled.redundancy)
    assert not test.passed
    (sentence,) = found(scaled, Kind.GLOBAL_TEST)
    assert f"between {test.lower:.3f} and {test.upper:.3f} is expected: the observations are {verdict} accurate" in (
        sentence.what
    )
    assert f"multiply all sigmas by {test.sigma0:.3g}" in sentence.cure


def test_global_test_has_the_tabulated_limits():
    test = global_test(1.0, 10)  # chi-square of 10 degrees of freedom: 3.247 and 20.483
    assert (10 * test.lower**2, 10 * test.upper**2) == pytest.approx((3.247, 20.483), abs=1e-3)


def test_groups_that_disagree_are_one_finding_with_absolute_factors(adjustment):
    """Multiplied by the factors, the sigmas agree with the residuals of their own group."""
    v = np.asarray(adjustment.weighted_residuals[0]) * 4
    worse = with_rays(adjustment, v)
    (sigmas,) = found(worse, Kind.SIGMAS)
    assert sigmas.severity is Severity.CHECK and not found(worse, Kind.GLOBAL_TEST)
    factors = {factor.name: factor.factor for factor in group_factors(worse)}
    r = redundancy_numbers(worse)[0]
    tie = adjustment.block.structure.point_free.all(1)[adjustment.block.structure.ray_point]
    for group in adjustment.block.groups:
        if group.structure.kind.name == "control":
            tie &= ~np.isin(adjustment.block.structure.ray_point, group.structure.indices[:, 0])
    assert factors["rays of tie points"] == pytest.approx(np.sqrt((v[tie] ** 2).sum() / r[tie].sum()), rel=1e-12)
    assert f"rays of tie points by {factors['rays of tie points']:.2f}" in sigmas.cure


def with_interior(adjustment: Adjustment, values: dict[int, float], cofactors: np.ndarray) -> Adjustment:
    elements = adjustment.block.interior.elements
    for k, value in values.items():
        elements = elements.at[0, k].set(value)
    assert adjustment.cofactors is not None
    q = adjustment.cofactors._replace(interior=jnp.asarray(cofactors))
    return eqx.tree_at(lambda a: (a.cofactors, a.block.interior.elements), adjustment, (q, elements))


def test_correlated_elements_are_told_once_per_camera(adjustment):
    q = np.asarray(adjustment.cofactors.interior).copy()
    q[0, 3, 4] = q[0, 4, 3] = -0.99 * np.sqrt(q[0, 3, 3] * q[0, 4, 4])
    (pair,) = found(with_interior(adjustment, {}, q), Kind.CORRELATED)
    assert "K1 and K2 by -0.990" in pair.what and pair.size == pytest.approx(-0.99)
    assert pair.subjects[:2] == (Subject("cameras", ("camera",), "K1"), Subject("cameras", ("camera",), "K2"))
    assert "convergent" in pair.cure  # an aerial block has neither convergent nor turned images


def test_elements_are_insignificant_together(adjustment):
    """Two correlated elements, each small against its own sd: together they are not, one of them may go."""
    q = np.asarray(adjustment.cofactors.interior).copy()
    scale = float(adjustment.sigma0)
    sd = 1e-9
    q[0, 3, 3] = q[0, 4, 4] = (sd / scale) ** 2
    q[0, 3, 4] = q[0, 4, 3] = -0.98 * (sd / scale) ** 2
    jointly = with_interior(adjustment, {3: 1.9 * sd, 4: 1.8 * sd}, q)
    (one,) = found(jointly, Kind.INSIGNIFICANT)
    assert one.subjects == (Subject("cameras", ("camera",), "K2"),) and one.cure == "fix it at 0"
    both = with_interior(adjustment, {3: 0.1 * sd, 4: 0.1 * sd}, q)
    (two,) = found(both, Kind.INSIGNIFICANT)
    assert {s.component for s in two.subjects} == {"K1", "K2"} and two.cure == "fix them at 0"
    assert not any(s.component in ("principal_distance", "x0", "y0") for s in two.subjects)


def test_backward_elimination_is_the_adjustment_with_the_element_held():
    """Holding an element in the normal equations gives what the conditional expectation says."""
    rng = np.random.default_rng(5)
    a, y = rng.normal(size=(12, 4)), rng.normal(size=12)
    normals = a.T @ a
    x, c = np.linalg.solve(normals, a.T @ y), np.linalg.inv(normals)
    x[0] = 1e-3 * np.sqrt(c[0, 0])
    held, ratios = insignificant(x, c)
    assert held[0] == 0
    left = [1, 2, 3]
    conditional = np.linalg.inv(np.linalg.inv(c)[np.ix_(left, left)])
    moved = x[left] - c[left, 0] / c[0, 0] * x[0]
    again, _ = insignificant(moved, conditional)
    assert [left[k] for k in again] == held[1:] and ratios[0] < 0.01


def test_a_weak_principal_distance(adjustment):
    q = np.asarray(adjustment.cofactors.interior).copy()
    scale = float(adjustment.sigma0)
    for sd in (2.0, 28.0):
        q[0, 0, 0] = (sd / scale) ** 2
        (weak,) = found(with_interior(adjustment, {}, q), Kind.WEAK)
        assert weak.subjects == (Subject("cameras", ("camera",), "principal_distance"),) and weak.unit == "mm"
        assert weak.size == pytest.approx(sd)


def test_correlations_of_what_has_no_variance():
    np.testing.assert_array_equal(correlations_of(np.array([[4.0, 0.0], [0.0, 0.0]])), [[1.0, 0.0], [0.0, 0.0]])


def test_points_whose_rays_are_parallel(adjustment):
    q = adjustment.cofactors.object_points.at[9, 2, 2].set(1e9)
    far = eqx.tree_at(lambda a: a.cofactors.object_points, adjustment, q)
    (weak,) = found(far, Kind.WEAK)
    assert weak.subjects == (Subject("points", (adjustment.block.structure.point_names[9],)),) and weak.unit == "m"


def test_check_points_that_are_off(adjustment):
    known = adjustment.block.check_points.coordinates
    sd = adjustment.standard_deviations.object_points[adjustment.block.structure.check_point[1], 2]
    moved = eqx.tree_at(lambda a: a.block.check_points.coordinates, adjustment, known.at[1, 2].add(280 * sd))
    (check,) = found(moved, Kind.CHECK_POINTS)
    name = adjustment.block.structure.point_names[adjustment.block.structure.check_point[1]]
    assert check.severity is Severity.CHECK and check.subjects == (Subject("control", (name,), "Z"),)
    assert check.size == pytest.approx(-280 * float(sd), rel=0.05)


def test_check_points_of_an_arbitrary_datum_say_nothing(adjustment):
    datum = dataclasses.replace(adjustment.block.structure.datum, kind="minimal")
    (note,) = found(with_structure(adjustment, datum=datum), Kind.CHECK_POINTS)
    assert note.severity is Severity.NOTE and "do not measure accuracy" in note.what


def test_a_small_redundancy(adjustment):
    observed = adjustment.block.structure
    few = len(observed.ray_image) - (adjustment.redundancy - 1) // 2
    short = with_structure(adjustment, ray_image=observed.ray_image[:few], ray_point=observed.ray_point[:few])
    short = dataclasses.replace(short, redundancy_numbers=None, cofactors=None, reweighting=None)
    short = dataclasses.replace(
        short, weighted_residuals=(short.weighted_residuals[0][:few], *short.weighted_residuals[1:])
    )
    assert 0 < short.redundancy < 10
    (redundancy,) = found(short, Kind.REDUNDANCY)
    assert redundancy.size == short.redundancy and "uncertain by" in redundancy.what


def test_uncontrolled_rays_and_observations(adjustment):
    numbers = [np.array(r) for r in adjustment.redundancy_numbers]
    numbers[0][[4, 9]] = 0.01
    numbers[2][3] = 1e-9
    loose = dataclasses.replace(adjustment, redundancy_numbers=tuple(map(jnp.asarray, numbers)))
    structure = adjustment.block.structure
    rays, stations = (f for f in found(loose, Kind.UNCONTROLLED) if f.severity is Severity.CHECK)
    pairs = [
        (structure.image_names[structure.ray_image[k]], structure.point_names[structure.ray_point[k]]) for k in (4, 9)
    ]
    assert rays.subjects == tuple(Subject("rays", pair) for pair in pairs)
    assert rays.cure == "measure these points on one more image"
    assert {s.table for s in stations.subjects} == {"stations"} and stations.size == np.inf


def test_points_on_two_images(adjustment):
    structure = adjustment.block.structure
    assert not found(adjustment, Kind.TWO_RAYS)
    first = np.arange(len(structure.ray_point)) % (len(structure.ray_point) // 2)
    twice = with_structure(adjustment, ray_point=np.minimum(first, len(structure.point_names) - 1).astype(np.int32))
    assert found(dataclasses.replace(twice, redundancy_numbers=None, cofactors=None), Kind.TWO_RAYS)


def test_what_was_left_out(adjustment):
    unused = Finding(Kind.UNUSED, "camera b has no image")
    noted = dataclasses.replace(adjustment, cofactors=None, redundancy_numbers=None, findings=(unused,))
    assert [f.words for f in findings(noted) if f.severity is Severity.NOTE] == [
        "no standard deviations were computed",
        "camera b has no image",
    ]


def test_error_along_the_base_is_controlled_less(adjustment):
    """A point on two images of one strip: an error along the base moves the point and nothing else."""
    s = adjustment.block.structure
    strip = np.array([name[0] for name in s.image_names])[s.ray_image]
    second = np.array([set(strip[s.ray_point == p]) == {"2"} for p in range(len(s.point_names))])
    two = (np.bincount(s.ray_point)[s.ray_point] == 2) & second[s.ray_point]
    r = redundancy_numbers(adjustment)[0][two]
    assert (r[:, 0] < r[:, 1]).mean() > 0.9


def test_many_cameras_are_one_finding():
    one = [Finding(Kind.CORRELATED, f"camera {k}", "hold", (Subject("cameras", (str(k),), "K1"),)) for k in range(9)]
    assert _together(one[:3]) == one[:3]
    (all_of_them,) = _together(one)
    assert all_of_them.what == "camera 0; likewise in 8 more cameras: 1, 2, 3, 4, 5, 6 and 2 more"
    assert [subject.names[0] for subject in all_of_them.subjects] == [str(k) for k in range(9)]


def test_principal_distance_that_the_flying_height_imitates_is_told(adjustment):
    """Vertical images of flat terrain, and stations that are hardly observed; relief and good stations tell it."""
    assert not flying_height_findings(adjustment)
    block = small_block(relief=1.0).block
    loose = [k for k, group in enumerate(block.groups) if group.structure.kind.name == "stations"][0]
    block = eqx.tree_at(lambda b: b.groups[loose].sigmas, block, 1e4 * block.groups[loose].sigmas)
    (told,) = flying_height_findings(adjust(block))
    assert told.kind is Kind.CORRELATED and told.subjects[0].component == "principal_distance"
    assert abs(told.size) > 0.99 and "mean Z0" in told.what and told.cure


def test_boresight_that_is_no_misalignment_is_told(unchecked_types):
    """Its angle is that of the whole rotation; a mounting that is off by degrees is none."""
    values = np.radians([1.0, -2.0, 183.0])
    structure = SimpleNamespace(
        parameters=[Parameter(f"boresight {name} of imu") for name in ("omega", "phi", "kappa")],
        parameter_free=np.ones(3, bool),
        rotation_system=OMEGA_PHI_KAPPA,
    )
    attitudes = SimpleNamespace(
        structure=SimpleNamespace(kind=ATTITUDES[OMEGA_PHI_KAPPA.name], indices=np.arange(10)[None] - 1)
    )
    block = SimpleNamespace(structure=structure, groups=[attitudes], parameters=values)
    adjustment: Any = SimpleNamespace(block=block)
    (told,) = boresight_findings(adjustment)
    assert told.size == pytest.approx(177.0, abs=0.2) and told.unit == "deg"
    assert "kappa by 180 deg" in told.cure and "omega by" not in told.cure
    block.parameters = np.radians([1.0, -2.0, 3.0])
    assert not boresight_findings(adjustment)
