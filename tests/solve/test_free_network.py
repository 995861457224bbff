"""Free networks: inner constraints, the smallest cofactors of all datums, and nothing else changed."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.dense_adjustment import centred, dense_system
from cases.free_networks import free_network, inner
from cases.simulated_blocks import small_block

from jaxbundle.block.block import Block
from jaxbundle.block.geodetic import DISTANCES
from jaxbundle.block.observation_kinds import observation_group
from jaxbundle.block.problems import BlockError
from jaxbundle.solve.adjust import adjust


def with_scale(block: Block) -> Block:
    """A distance between two tie points, which are then not eliminated."""
    ends = np.asarray(block.object_points)[[3, 9]]
    length = np.linalg.norm(ends[1] - ends[0])
    group = observation_group(DISTANCES, np.array([[3, 9]]), np.array([[length + 0.3]]), np.array([[0.02]]))
    return dataclasses.replace(block, groups=(group,))


@pytest.fixture(scope="module", params=["all points", "chosen points and a distance"])
def networks(request):
    block, chosen = free_network(2), ()
    if request.param != "all points":
        block = with_scale(block)
        chosen = block.structure.point_names[:12]
    return (
        block,
        adjust(inner(block, chosen)),
        adjust(block),
        np.isin(block.structure.point_names, chosen) | (not chosen),
    )


def test_residuals_and_sigma0_are_those_of_the_minimal_datum(networks):
    block, free, minimal, _ = networks
    assert free.trustworthy
    np.testing.assert_allclose(free.sigma0, minimal.sigma0, rtol=1e-9)
    np.testing.assert_allclose(free.residuals[0], minimal.residuals[0], atol=1e-9)
    assert free.redundancy == minimal.redundancy
    assert free.n_unknowns == block.structure.n_unknowns == minimal.n_unknowns + free.block.structure.datum.constraints
    assert "inner constraints over" in free.summary()
    assert not free.block.structure.datum.held


def test_no_shift_no_rotation_no_scale_against_the_approximate_coordinates(networks):
    block, free, _, chosen = networks
    x0, x = (np.asarray(b.object_points)[chosen] for b in (block, free.block))
    x0c = x0 - x0.mean(0)
    size = np.abs(x0c).max()
    np.testing.assert_allclose((x - x0).mean(0), 0, atol=1e-9 * size)
    np.testing.assert_allclose(np.cross(x0c, x - x0).mean(0), 0, atol=1e-9 * size**2)
    if free.block.structure.datum.constraints == 7:
        np.testing.assert_allclose((x0c * (x - x0)).sum(1).mean(), 0, atol=1e-9 * size**2)


def test_cofactors_are_those_of_the_pseudo_inverse(networks):
    """Over all points they are the blocks of the dense inverse with the constraints as a border."""
    block, free, minimal, chosen = networks
    unknowns, o = centred(free.block)
    o = eqx.tree_at(lambda o: o.in_angles, o, jnp.ones(o.image_camera.shape, bool), is_leaf=lambda leaf: leaf is None)
    design = dense_system(unknowns, o).design
    images, points = unknowns.centre.shape[1], unknowns.points.shape[1]
    first = 6 * images
    g = np.zeros((7, design.shape[1]))
    x = np.asarray(unknowns.points) * chosen  # columns of the points: all X, then all Y, then all Z
    unit = np.broadcast_to(chosen.astype(float), (points,))
    for k in range(3):
        g[k, first + k * points : first + (k + 1) * points] = unit
        i, j = (k + 1) % 3, (k + 2) % 3
        g[3 + k, first + i * points : first + (i + 1) * points] = -x[j]
        g[3 + k, first + j * points : first + (j + 1) * points] = x[i]
        g[6, first + k * points : first + (k + 1) * points] = x[k]
    g = g[: free.block.structure.datum.constraints]
    scale = np.linalg.norm(design, axis=0)
    bordered = np.block(
        [[(design / scale).T @ (design / scale), (g / scale).T], [g / scale, np.zeros((len(g), len(g)))]]
    )
    q = np.linalg.inv(bordered)[: len(scale), : len(scale)] / scale / scale[:, None]
    diagonal = np.diagonal(q)
    sd = np.sqrt(np.concatenate([diagonal[:first].reshape(6, -1).ravel(), diagonal[first:]]))
    found = free.standard_deviations
    sigma0 = float(free.sigma0)
    exterior = np.concatenate([found.projection_centre.T, found.angles.T]).ravel() / sigma0
    np.testing.assert_allclose(
        np.concatenate([exterior, np.asarray(found.object_points).T.ravel() / sigma0]), sd, rtol=1e-6
    )
    trace = [float(jnp.trace(a.cofactors.object_points[chosen], axis1=1, axis2=2).sum()) for a in (free, minimal)]
    assert trace[0] < trace[1]


def test_inner_constraints_and_control_exclude_each_other():
    with pytest.raises(BlockError, match="exclude each other"):
        adjust(inner(small_block().block))


def test_free_network_again_from_its_result(networks):
    _, free, _, _ = networks
    again = adjust(free.block, precision=False)
    assert again.block.structure.datum.constraints == free.block.structure.datum.constraints
    np.testing.assert_allclose(again.block.object_points, free.block.object_points, atol=1e-6)


def test_free_networks_are_not_traced():
    block = inner(free_network(2))
    with pytest.raises(ValueError, match="inside jit"):
        jax.eval_shape(lambda b: adjust(b).sigma0, block)
