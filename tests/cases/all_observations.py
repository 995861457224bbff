"""Blocks with every kind of observation, at their true values: what is observed is computed from the truth."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbundle.block.block import Block, Parameter
from jaxbundle.block.datum import with_datum
from jaxbundle.block.geodetic import LINES, PLANES, geodetic_kind
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, PARAMETERS, ObservationKind, interior_priors, observation_group
from jaxbundle.block.residuals import group_arrays, group_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.monte_carlo_runs import drawn
from jaxbundle.planning.simulation import simulate

__all__ = ["CASES", "case", "drawn", "in_batches", "observed", "strip", "tie_points", "with_parameters"]


def strip(control_sigma: float = 0.05) -> Block:
    """A strip with weighted control and a self-calibrated camera."""
    camera = AerialCamera(estimate=("principal_distance",))
    return simulate(1, 3, camera=camera, points_per_image=14, control_sigma=control_sigma, check_points=0, seed=3).truth


def tie_points(block: Block) -> np.ndarray:
    """Points that are no control, best seen first."""
    control = np.concatenate([g.structure.indices[:, 0] for g in block.groups if g.structure.kind == CONTROL])
    order = np.argsort(-np.bincount(block.structure.ray_point), kind="stable")
    return order[~np.isin(order, control)]


def with_parameters(block: Block, values: dict[str, float], held: tuple[str, ...] = ()) -> tuple[Block, np.ndarray]:
    """The block with more parameters, and their numbers."""
    first = len(block.structure.parameters)
    parameters = (*block.structure.parameters, *(Parameter(name, free=name not in held) for name in values))
    structure = dataclasses.replace(block.structure, parameters=parameters)
    block = dataclasses.replace(block, structure=structure)
    numbers = jnp.concatenate([block.parameters, jnp.array(list(values.values()))])
    return eqx.tree_at(lambda b: b.parameters, block, numbers), first + np.arange(len(values))


def observed(
    block: Block,
    kind: ObservationKind,
    indices,
    sigmas,
    constants: np.ndarray | None = None,
    covariances: np.ndarray | None = None,
) -> Block:
    """The block with observations of one kind, without errors."""
    indices = np.atleast_2d(indices)
    sigmas = np.broadcast_to(sigmas, (len(indices), len(kind.components)))
    group = observation_group(kind, indices, np.zeros(sigmas.shape), sigmas, constants, covariances)
    values = group_residuals(unknowns_of(block), group_arrays(group, indices.T)).T
    return dataclasses.replace(block, groups=(*block.groups, eqx.tree_at(lambda g: g.values, group, values)))


def geodetic(block: Block) -> Block:
    """Distances, height differences, azimuths, zenith angles, and two sets of directions, one from a centre."""
    p = tie_points(block)
    pairs = np.array([[p[0], p[4]], [p[1], 0]])
    for name, sigma in (
        ("distances", 0.02),
        ("horizontal_distances", 0.02),
        ("height_differences", 0.02),
        ("azimuths", 1e-4),
        ("zenith_angles", 1e-4),
    ):
        block = observed(block, geodetic_kind(name), pairs, sigma)
    block = observed(block, geodetic_kind("distances", "image"), [[1, p[2]]], 0.02)
    block, (one, two) = with_parameters(block, {"orientation 1": 0.4, "orientation 2": -2.0})
    block = observed(block, geodetic_kind("directions"), [[p[3], q, one] for q in (0, 1, p[5])], 1e-4)
    return observed(block, geodetic_kind("directions", "image"), [[0, q, two] for q in (0, p[1], p[2])], 1e-4)


def figures(block: Block) -> Block:
    """Scale bars of a common length with a prior, a plumb line, a plane and a line."""
    p = tie_points(block)
    values = {"bar": 300.0, "tilt x": 0.1, "tilt y": -0.2, "height": 3.0, "a": 0.02, "b": 0.03, "p": 5.0, "q": 6.0}
    block, n = with_parameters(block, values)
    block = observed(block, geodetic_kind("scale_bars"), [[p[0], p[1], n[0]], [p[2], p[3], n[0]]], 0.02)
    block = observed(block, PARAMETERS, [[n[0]]], 0.05)
    block = observed(block, geodetic_kind("plumb_lines"), [[p[4], p[5]]], 0.03)
    middle = np.asarray(block.object_points).mean(0)
    upright = np.tile([*middle, *np.eye(3).ravel()], (5, 1))
    block = observed(block, PLANES, [[q, *n[1:4]] for q in p[:5]], 0.02, upright)
    along = np.tile([*middle, 0, 0, 1, 1, 0, 0, 0, 1, 0], (4, 1))
    return observed(block, LINES, [[q, *n[4:8]] for q in p[3:7]], 0.02, along)


def navigation(block: Block) -> Block:
    """Centres with shift, drift and a known lever arm, attitudes with an unknown boresight and a drift."""
    held = tuple(f"{name} {axis}" for name in ("lever", "attitude shift") for axis in "XYZ")
    sizes = {
        "lever": 0.3,
        "shift": 2.0,
        "drift": 0.1,
        "boresight": 0.02,
        "attitude shift": 0.0,
        "attitude drift": 0.001,
    }
    values = {f"{name} {axis}": size * (k + 1) for name, size in sizes.items() for k, axis in enumerate("XYZ")}
    block, n = with_parameters(block, values, held)
    images = np.arange(len(block.structure.image_names))
    time = np.linspace(-1, 1, len(images))[:, None]
    block = observed(block, GNSS_STATIONS, [[i, *n[:9]] for i in images], 0.05, time)
    attitudes = ATTITUDES[block.structure.rotation_system.name]
    block = observed(block, attitudes, [[i, *n[9:]] for i in images], 2e-4, time)
    return observed(block, PARAMETERS, n[3:9, None], 1.0)


def correlated(block: Block) -> Block:
    """Control with a full covariance matrix, one coordinate of it not observed; a prior of the principal distance."""
    shape = np.random.default_rng(1).normal(0, 0.05, (4, 3, 3))
    block = observed(
        block, CONTROL, tie_points(block)[:4, None], 1.0, None, shape @ shape.transpose(0, 2, 1) + 1e-4 * np.eye(3)
    )
    mask = np.ones((4, 3), bool)
    mask[1, 2] = False
    group = block.groups[-1]
    group = dataclasses.replace(group, structure=dataclasses.replace(group.structure, observed=mask))
    block = dataclasses.replace(block, groups=(*block.groups[:-1], group))
    (camera,) = block.structure.cameras
    sigmas = np.where(np.arange(len(camera.model.elements)) == 0, 0.01, np.nan)
    group = observation_group(
        interior_priors(camera.model.elements), np.zeros((1, 1), int), np.asarray(block.interior.elements), sigmas[None]
    )
    return dataclasses.replace(block, groups=(*block.groups, group))


CASES = {"geodetic": geodetic, "figures": figures, "navigation": navigation, "correlated": correlated}


def everything(block: Block) -> Block:
    """All kinds in one block: one program of each computation serves them all."""
    return correlated(figures(navigation(geodetic(block))))


def forms(block: Block) -> Block:
    """One kind of each form: touched points, images and parameters, of this and that number; correlated or not.

    What is computed by autodiff of the residuals does not know one kind of a form from another. An angle is held.
    """
    p = tie_points(block)
    middle = np.asarray(block.object_points).mean(0)
    block = observed(block, geodetic_kind("distances"), [[p[0], p[4]], [p[1], 0]], 0.02)
    block = observed(block, geodetic_kind("distances", "image"), [[1, p[2]]], 0.02)
    block, (one, two, *plane) = with_parameters(block, {"one": 0.4, "two": -2.0, "x": 0.1, "y": -0.2, "height": 3.0})
    block = observed(block, geodetic_kind("directions"), [[p[3], q, one] for q in (0, 1, p[5])], 1e-4)
    block = observed(block, geodetic_kind("directions", "image"), [[0, q, two] for q in (0, p[1], p[2])], 1e-4)
    upright = np.tile([*middle, *np.eye(3).ravel()], (5, 1))
    block = observed(block, PLANES, [[q, *plane] for q in p[:5]], 0.02, upright)
    free = block.structure.exterior_free.copy()
    free[1, 4] = False
    structure = dataclasses.replace(block.structure, exterior_free=free)
    return correlated(navigation(dataclasses.replace(block, structure=structure)))


def case(name: str) -> Block:
    """One of the blocks, its datum chosen."""
    return with_datum((CASES | {"all observations": everything, "all forms": forms})[name](strip()))


def in_batches(one: Callable, size: int = 100) -> Callable:
    """`one` vmapped over batches: all draws at once would take gigabytes."""
    return lambda keys: jax.lax.map(one, keys, batch_size=size)
