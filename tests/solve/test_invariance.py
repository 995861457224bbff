"""What must not matter to an adjustment: order, origin, unit and axes of the object system, the system of angles."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from cases.shuffled import shuffled
from cases.simulated_blocks import small_block
from jaxtyping import Float

from jaxbundle.block.block import Block, ExteriorOrientation
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.geometry.rotation import ALPHA_OMEGA_KAPPA
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Adjustment

SAME_VALUE = 1e-6  # standard deviations; a solve ends some 1e-8 of them off the minimum
SAME_SD = 1e-7  # relative

Coordinates = Float[np.ndarray, "entity 3"]


class Results(NamedTuple):
    """What an adjustment says, attitudes as matrices object_from_image."""

    sigma0: float
    centres: Coordinates
    centre_sd: Coordinates
    matrices: Float[np.ndarray, "image 3 3"]
    interior: Float[np.ndarray, "camera element"]
    interior_sd: Float[np.ndarray, "camera element"]
    points: Coordinates
    point_sd: Coordinates


def results(adjustment: Adjustment) -> Results:
    """The results of an adjustment that can be trusted."""
    assert adjustment.trustworthy
    found, sd = adjustment.block, adjustment.standard_deviations
    matrices = jnp.stack(found.structure.rotation_system.rotation_from_angles(*found.exterior.angles.T), 1)
    arrays = (
        found.exterior.projection_centre,
        sd.projection_centre,
        matrices.reshape(-1, 3, 3),
        found.interior.elements,
        sd.interior,
        found.object_points,
        sd.object_points,
    )
    return Results(float(adjustment.sigma0), *map(np.asarray, arrays))


def assert_same(found: Results, expected: Results) -> None:
    """Values to a small part of their standard deviations."""
    assert found.sigma0 == pytest.approx(expected.sigma0, rel=1e-10)
    np.testing.assert_allclose(found.matrices, expected.matrices, rtol=0, atol=1e-10)
    for values, expected_values, sd, expected_sd in (
        (found.centres, expected.centres, found.centre_sd, expected.centre_sd),
        (found.interior, expected.interior, found.interior_sd, expected.interior_sd),
        (found.points, expected.points, found.point_sd, expected.point_sd),
    ):
        np.testing.assert_allclose(sd, expected_sd, rtol=SAME_SD)
        rounding = 1e-12 * np.abs(expected_values).max()
        assert (np.abs(values - expected_values) <= SAME_VALUE * expected_sd + rounding).all()


@pytest.fixture(scope="module")
def block() -> Block:
    return small_block().block


@pytest.fixture(scope="module")
def reference(block) -> Results:
    return results(adjust(block))


def test_order(block, reference):
    """Of images, points, rays, control points and stations."""
    again, image, point = shuffled(block, np.random.default_rng(7))
    expected = reference._replace(
        **{name: getattr(reference, name)[image] for name in ("centres", "centre_sd", "matrices")},
        **{name: getattr(reference, name)[point] for name in ("points", "point_sd")},
    )
    assert_same(results(adjust(again)), expected)


@pytest.mark.parametrize("shift", [(5e5, -5e5, 5e5), (5e5, 5e6, 0.0)], ids=["500 km", "UTM"])
def test_origin(block, reference, shift):
    """A coordinate of thousands of kilometres keeps a nanometre: nothing is lost but that."""
    found = adjust(block.moved(jnp.array(shift)))
    back = dataclasses.replace(found, block=found.block.moved(-jnp.array(shift)))
    assert_same(results(back), reference)


def lengths(block: Block) -> tuple:
    """All values in the unit of the object system."""
    groups = [values for group in block.groups for values in (group.values, group.sigmas)]
    check = block.check_points
    return block.exterior.projection_centre, block.object_points, check.coordinates, check.sigmas, *groups


def test_unit(block, reference):
    """Metres or millimetres."""
    millimetres = eqx.tree_at(lengths, block, tuple(1000 * values for values in lengths(block)))
    found = results(adjust(millimetres))
    names = ("centres", "centre_sd", "points", "point_sd")
    assert_same(found._replace(**{name: getattr(found, name) / 1000 for name in names}), reference)


def test_system_of_angles(block, reference):
    angles = ALPHA_OMEGA_KAPPA.angles_from_rotation(tuple(reference.matrices.reshape(-1, 9).T))
    structure = dataclasses.replace(block.structure, rotation_system=ALPHA_OMEGA_KAPPA)
    again = eqx.tree_at(lambda b: b.exterior.angles, block, jnp.stack(angles, 1))
    assert_same(results(adjust(dataclasses.replace(again, structure=structure))), reference)


def turned(coordinates, sign: float):
    """Coordinates in axes turned by 90 deg about X: what looked down looks along Y (sign 1) or against it (-1)."""
    x, y, z = coordinates.T
    return np.stack([x, -sign * z, sign * y], -1)


def turned_group(group: ObservationGroup, sign: float) -> ObservationGroup:
    structure = dataclasses.replace(group.structure, observed=group.structure.observed[:, [0, 2, 1]])
    sigmas = group.sigmas[:, jnp.array([0, 2, 1])]
    return ObservationGroup(structure, jnp.asarray(turned(group.values, sign)), sigmas, group.constants)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_horizontal_cameras(block, reference, sign):
    """The block stood on edge, from attitudes exactly at the singular place of alpha-omega-kappa: omega = +-90 deg."""
    back = np.array([name.startswith("2") for name in block.structure.image_names])  # the strip flown back
    angles = np.stack([0.0 * back, np.full(len(back), sign * np.pi / 2), np.pi * back], 1)
    structure = dataclasses.replace(
        block.structure,
        rotation_system=ALPHA_OMEGA_KAPPA,
        point_free=block.structure.point_free[:, [0, 2, 1]],
    )
    upright = eqx.tree_at(
        lambda b: (b.exterior, b.object_points),
        dataclasses.replace(block, structure=structure, groups=tuple(turned_group(g, sign) for g in block.groups)),
        (
            ExteriorOrientation(jnp.asarray(turned(block.exterior.projection_centre, sign)), jnp.asarray(angles)),
            jnp.asarray(turned(block.object_points, sign)),
        ),
    )
    by_axes = np.array([[1, 0, 0], [0, 0, -sign], [0, sign, 0]])
    expected = reference._replace(
        centres=turned(reference.centres, sign),
        centre_sd=reference.centre_sd[:, [0, 2, 1]],
        matrices=by_axes @ reference.matrices,
        points=turned(reference.points, sign),
        point_sd=reference.point_sd[:, [0, 2, 1]],
    )
    adjusted = adjust(upright)
    assert adjusted.trustworthy
    assert all(np.isfinite(sd).all() for sd in adjusted.standard_deviations)
    assert_same(results(adjusted), expected)
