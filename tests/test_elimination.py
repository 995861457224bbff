"""Elimination changes nothing: steps and standard deviations are those of the dense equations."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from dense import centred, dense_cofactors, dense_step, dense_system, difference, free_values, masks, sizes
from simulated import small_block

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observations import observation_group
from jaxbundle.block.unknowns import Unknowns, unknowns_of
from jaxbundle.camera.brown import BROWN, DISTORTION_FREE
from jaxbundle.normals.arrange import arrange, arranged_unknowns, problem, restored_unknowns
from jaxbundle.normals.reduced_plan import Method
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.levenberg_marquardt import Arguments, BundleSolver, run
from jaxbundle.solve.search import FullStep
from jaxbundle.solve.stopping import AngleRule

DAMPINGS = (1e-12, 1e-8, 1e-4, 1e-2, 1.0, 1e3, 1e6)


def block_steps(block: Block, dampings: tuple[float, ...], reduced: Method, devices: int) -> list[Unknowns]:
    """The unknowns after one step of the solver at each damping; the only place that knows how a step is made."""
    centres = np.asarray(block.exterior.projection_centre)
    arrangement = arrange(block.structure, block.groups, centres, devices, reduced)
    block = block.moved(-jnp.mean(block.exterior.projection_centre, 0))
    start, args = (
        arranged_unknowns(arrangement, unknowns_of(block)),
        Arguments(problem(arrangement, block), AngleRule()),
    )
    solver = BundleSolver(FullStep())  # which takes whatever step it is given
    stepped = []
    for damping in dampings:
        state = eqx.tree_at(lambda s: s.search.damping, solver.first(), jnp.array(damping, float))
        stepped.append(restored_unknowns(arrangement, run(solver, start, args, state, 1, optimised=False)[0]))
    return stepped


def changed(block: Block, **changes: object) -> Block:
    """The block with another structure."""
    return dataclasses.replace(block, structure=dataclasses.replace(block.structure, **changes))


def with_distances(block: Block) -> Block:
    """Distances between tie points, and from a control point to a tie point: those points are not eliminated."""
    structure = block.structure
    tie = np.flatnonzero(structure.point_free.all(1) & (np.bincount(structure.ray_point) > 2))
    pairs = np.array([[tie[0], tie[5]], [0, tie[2]], [tie[5], tie[9]]])
    lengths = np.linalg.norm(np.diff(np.asarray(block.object_points)[pairs], axis=1)[:, 0], axis=1)
    group = observation_group(DISTANCES, pairs, lengths[:, None] + 0.5, np.full((3, 1), 0.02))
    return dataclasses.replace(block, groups=(*block.groups, group))


def with_private_cameras(block: Block) -> Block:
    """Every image has a camera of its own, of which every second one is self-calibrated."""
    images = len(block.structure.image_names)
    (camera,) = block.structure.cameras
    cameras = tuple(dataclasses.replace(camera, name=f"camera {k}") for k in range(images))
    free = np.repeat(block.structure.interior_free, images, 0)
    free[::2] = False
    block = changed(block, cameras=cameras, image_camera=np.arange(images, dtype=np.int32), interior_free=free)
    elements = jnp.repeat(block.interior.elements, images, 0)
    return eqx.tree_at(lambda b: b.interior.elements, block, elements)


def with_held_angles(block: Block) -> Block:
    """One image keeps an angle, another one two, a third one its whole orientation."""
    free = block.structure.exterior_free.copy()
    free[1, 4] = free[2, 3] = free[2, 5] = False
    free[6] = False
    return changed(block, exterior_free=free)


def with_two_models(block: Block) -> Block:
    """The second strip is taken with a camera without distortion, of which the principal distance is estimated."""
    (camera,) = block.structure.cameras
    second = dataclasses.replace(camera, name="second", model=DISTORTION_FREE)
    strip = np.array([name.startswith("2") for name in block.structure.image_names])
    free = np.zeros((2, len(BROWN.elements)), bool)
    free[0], free[1, 0] = block.structure.interior_free[0], True
    block = changed(block, cameras=(camera, second), image_camera=strip.astype(np.int32), interior_free=free)
    by_name = dict(zip(BROWN.elements, block.interior.elements[0], strict=True))
    own = [by_name[name] for name in DISTORTION_FREE.elements]
    padded = jnp.array([*own, *[1.0] * (len(BROWN.elements) - len(own))])
    return eqx.tree_at(lambda b: b.interior.elements, block, jnp.stack([block.interior.elements[0], padded]))


BLOCKS = {
    "shared camera": lambda block: with_held_angles(with_distances(block)),
    "private cameras": lambda block: with_distances(with_private_cameras(block)),
    "two models": with_two_models,
}


@pytest.fixture(scope="module", params=BLOCKS)
def block(request) -> Block:
    """Two strips with weighted and fixed control, observed stations and self-calibration, and something more."""
    return BLOCKS[request.param](small_block().block)


def assert_dense_steps(block: Block, reduced: Method, devices: int = 1) -> None:
    """From approximate values far off, at dampings from none to a gradient step."""
    unknowns, observations = centred(block)
    system = dense_system(unknowns, observations)
    assert len(system.lengths) == block.structure.unknowns
    # the last digit of values of some kilometres is felt by steps of a hundredth of a millimetre
    rounding = np.finfo(float).eps * np.linalg.norm(system.lengths * sizes(unknowns, observations))
    for damping, stepped in zip(DAMPINGS, block_steps(block, DAMPINGS, reduced, devices), strict=True):
        expected = dense_step(system, damping)
        off = difference(unknowns, stepped, observations) - expected
        allowed = 1e-10 * np.linalg.norm(system.lengths * expected) + rounding
        assert np.linalg.norm(system.lengths * off) < allowed, damping


def test_steps(block):
    assert_dense_steps(block, "auto")


def test_steps_in_panels():
    assert_dense_steps(BLOCKS["shared camera"](small_block().block), "panels", 2)


def test_steps_by_conjugate_gradients(block):
    assert_dense_steps(block, "pcg")


def test_standard_deviations(block):
    """At the minimum, the attitudes in the user's angles."""
    adjustment = adjust(block, method="gauss-newton")
    assert adjustment.status is Status.CONVERGED
    unknowns, observations = centred(adjustment.block)
    expected = float(adjustment.sigma0) * np.sqrt(np.diagonal(dense_cofactors(unknowns, observations)))
    sd = adjustment.standard_deviations
    interior = jnp.pad(sd.interior, ((0, 0), (0, unknowns.interior.shape[0] - sd.interior.shape[1])))
    found = free_values(
        sd.projection_centre.T, sd.angles.T, interior.T, sd.parameters, sd.object_points.T, observations
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    exterior_free, interior_free, parameter_free, point_free = masks(observations)
    held = exterior_free.T, interior_free.T, parameter_free, point_free.T
    exterior = np.hstack([sd.projection_centre, sd.angles])
    columns = np.asarray(sd.interior)[:, np.array(observations.columns, int)]
    for values, free in zip(
        (exterior, columns, np.asarray(sd.parameters), np.asarray(sd.object_points)), held, strict=True
    ):
        assert not values[~free].any()  # what is held has none


def test_redundancy_numbers(block):
    """Each is 1 less the leverage of its row, and they sum to the redundancy."""
    adjustment = adjust(block, method="gauss-newton")
    system = dense_system(*centred(adjustment.block))
    leverages = np.sum(np.linalg.qr(system.design / system.lengths)[0] ** 2, 1)
    assert adjustment.redundancy_numbers is not None
    found = np.concatenate([np.asarray(r).T.ravel() for r in adjustment.redundancy_numbers])
    observed = system.design.any(1)
    np.testing.assert_allclose(found[observed], 1 - leverages[observed], atol=1e-9)
    assert found.sum() == pytest.approx(adjustment.redundancy, rel=1e-9)
