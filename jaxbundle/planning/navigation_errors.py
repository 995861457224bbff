"""Navigation data of a flight: centres and attitudes observed in flight, with shift, drift, lever arm and boresight.

Without systematic errors, centres are simple observed stations. Shifts and drifts belong to the whole flight or to
each strip; drifts are per exposure, counted from the middle of their group.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block, Owner, Parameter
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import STATIONS, ObservationGroup, ObservationKind, observation_group
from jaxbundle.block.residuals import group_arrays, group_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.planning.drawn_flight import Scene
from jaxbundle.planning.flight import FlightPlan, Navigation


class Table(NamedTuple):
    """A kind of observation and the names of its systematic errors."""

    kind: ObservationKind
    vectors: tuple[str, str, str]


CENTRES = Table(GNSS_STATIONS, ("lever_arm", "shift", "drift"))
ANGLES = Table(ATTITUDES[OMEGA_PHI_KAPPA.name], ("boresight", "attitude_shift", "attitude_drift"))


class Observed(NamedTuple):
    """Groups of observations without errors, and their parameters with true values."""

    groups: tuple[ObservationGroup, ...]
    parameters: tuple[Parameter, ...]
    values: Float[np.ndarray, " parameter"]


NOTHING = Observed((), (), np.zeros(0))


def navigation_of(plan: FlightPlan, scene: Scene, rng: np.random.Generator) -> Observed:
    """All observations in flight; `consistent_groups` computes the observed values."""
    found = NOTHING
    if plan.gnss is not None:
        if plan.gnss.plain:
            indices = np.arange(len(scene.centres))[:, None]
            sigmas = np.broadcast_to(plan.gnss.sigmas, scene.centres.shape)
            found = found._replace(groups=(observation_group(STATIONS, indices, scene.centres, sigmas),))
        else:
            found = _with(found, CENTRES, plan.gnss, scene, rng)
    if plan.ins is not None:
        found = _with(found, ANGLES, plan.ins, scene, rng)
    return found


def _with(found: Observed, table: Table, given: Navigation, scene: Scene, rng: np.random.Generator) -> Observed:
    """The observations of one kind, with nine parameters for each group of images."""
    kind, vectors = table
    strips = scene.stations.strip if given.systematic == "strip" else np.zeros_like(scene.stations.strip)
    parameters, values, numbers = list(found.parameters), list(found.values), []
    for group in range(int(strips.max()) + 1):
        numbers.append(len(parameters) + np.arange(9))
        name = f"strip {group + 1}" if given.systematic == "strip" else "" if given.plain else "flight"
        truth = _true_values(given, rng)
        unknown = (given.offset_unknown, given.systematic != "none", given.systematic != "none")
        for vector, free, three in zip(vectors, unknown, truth, strict=True):
            unit = ("deg" if kind.angles else "m") + ("/t" if vector.endswith("drift") else "")
            for axis, value in zip(kind.components, three, strict=True):
                axis = axis.removesuffix("0")
                called = f"{vector} {axis}" + (f" of {name}" if name else "")
                owner = Owner("navigation", name) if name else None
                parameters.append(Parameter(called, unit, free, kind.angles, owner))
                values.append(value)
    images = np.arange(len(strips))
    indices = np.c_[images, np.array(numbers)[strips]]
    sigmas = np.broadcast_to(given.sigmas, (len(images), 3))
    time = scene.stations.time
    middle = np.array([time[strips == group].mean() for group in range(len(numbers))])
    constants = (time - middle[strips])[:, None]
    observed = observation_group(kind, indices, np.zeros(sigmas.shape), sigmas, constants)
    return Observed((*found.groups, observed), tuple(parameters), np.array(values))


def _true_values(given: Navigation, rng: np.random.Generator) -> tuple[Float[np.ndarray, "3"], ...]:
    if given.systematic == "none":
        return np.array(given.offset), np.zeros(3), np.zeros(3)
    return np.array(given.offset), given.shift * rng.standard_normal(3), given.drift * rng.standard_normal(3)


def consistent_groups(block: Block) -> tuple[ObservationGroup, ...]:
    """All groups of observations with values without residuals; works with jit, grad and vmap."""
    unknowns = unknowns_of(block)

    def consistent(group: ObservationGroup) -> ObservationGroup:
        residuals: Array = group_residuals(unknowns, group_arrays(group, group.structure.indices.T)).T
        return eqx.tree_at(
            lambda g: g.values, group, group.values + jnp.where(group.structure.observed, residuals, 0.0)
        )

    return tuple(map(consistent, block.groups))
