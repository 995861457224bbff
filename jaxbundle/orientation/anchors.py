"""Anchors of a part of a block in the object system: control, observed stations, given orientations.

An anchor is a position in the part with its object coordinates; unknown coordinates are NaN.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.navigation import ATTITUDES, GNSS_STATIONS
from jaxbundle.block.observation_kinds import CONTROL, STATIONS
from jaxbundle.numerics.host import on_host

ENOUGH = 3  # minimum number of anchors with all coordinates


class Given(NamedTuple):
    """Object coordinates and attitudes that are observed, fixed, or given for images that are not to be replaced."""

    points: Float[np.ndarray, "point 3"]
    point_sigmas: Float[np.ndarray, "point 3"]
    centres: Float[np.ndarray, "image 3"]
    centre_sigmas: Float[np.ndarray, "image 3"]
    attitudes: Float[np.ndarray, "image 3 3"]
    """Rotations object_from_image, NaN if unknown."""
    oriented: Bool[np.ndarray, " image"]
    """Mask of the images with a given orientation."""
    rough: Float[np.ndarray, "image 3"]
    """Approximate centres, used if the observed ones are not sufficient."""


class Anchors(NamedTuple):
    """Positions in a part and in the object system."""

    model: Float[np.ndarray, "anchor 3"]
    object_points: Float[np.ndarray, "anchor 3"]
    sigmas: Float[np.ndarray, "anchor 3"]
    is_point: Bool[np.ndarray, " anchor"]
    number: Int[np.ndarray, " anchor"]
    """Index of the point or of the image."""

    @property
    def full(self) -> Bool[np.ndarray, " anchor"]:
        """Mask of the anchors with three known coordinates."""
        return np.asarray(np.isfinite(self.object_points).all(1))

    def only(self, chosen: Bool[np.ndarray, " anchor"]) -> "Anchors":
        """The selection of some anchors."""
        return Anchors(*(values[chosen] for values in self))


def given_of(block: Block, replaced: Bool[np.ndarray, " image"]) -> Given:
    """The known values of a block; orientations of the images in `replaced` are not used."""
    s = block.structure
    points = np.where(s.point_free, np.nan, on_host(block.object_points))
    centres, angles = np.array(block.exterior.projection_centre), np.array(block.exterior.angles)
    oriented = np.isfinite(np.c_[centres, angles]).all(1) & ~replaced
    held = ~s.exterior_free
    rough = np.where(replaced[:, None], np.nan, centres)
    centres = np.where(held[:, :3], centres, np.nan)
    angles[~(oriented | held[:, 3:].all(1))] = np.nan
    point_sigmas, centre_sigmas = np.zeros(points.shape), np.zeros(centres.shape)
    for group in block.groups:
        kind, observed = group.structure.kind, group.structure.observed
        index = group.structure.indices[:, 0]
        values = np.where(observed, on_host(group.values), np.nan)
        sigmas = np.where(observed, on_host(group.sigmas), 0.0)
        if kind is CONTROL:
            _fill(points, point_sigmas, index, values, sigmas)
        elif kind in (STATIONS, GNSS_STATIONS):
            _fill(centres, centre_sigmas, index, values, sigmas)
        elif kind in ATTITUDES.values():
            new = np.isnan(angles[index]).any(1) & observed.all(1)
            angles[index[new]] = values[new]
    rotation = np.stack([np.asarray(x) for x in s.rotation_system.rotation_from_angles(*angles.T)], 1)
    return Given(points, point_sigmas, centres, centre_sigmas, rotation.reshape(-1, 3, 3), oriented, rough)


def _fill(
    places: np.ndarray, all_sigmas: np.ndarray, index: np.ndarray, values: np.ndarray, sigmas: np.ndarray
) -> None:
    """Copies coordinates where none are known yet."""
    new = np.isnan(places[index]) & np.isfinite(values)
    places[index] = np.where(new, values, places[index])
    all_sigmas[index] = np.where(new, sigmas, all_sigmas[index])


def anchors_of(
    given: Given,
    images: Int[np.ndarray, " image"],
    centre: Float[np.ndarray, "image 3"],
    points: Float[np.ndarray, "point 3"],
) -> Anchors:
    """The anchors of a part: its images with their centres, and its points, NaN if missing."""
    known = np.flatnonzero(np.isfinite(given.points).any(1) & np.isfinite(points).all(1))
    full = np.isfinite(given.points[known]).all(1).sum() + np.isfinite(given.centres[images]).all(1).sum()
    if full < ENOUGH:
        given = given._replace(centres=np.where(np.isnan(given.centres), given.rough, given.centres))
    stations = np.flatnonzero(np.isfinite(given.centres[images]).any(1))
    return Anchors(
        np.concatenate([points[known], centre[stations]]),
        np.concatenate([given.points[known], given.centres[images[stations]]]),
        np.concatenate([given.point_sigmas[known], given.centre_sigmas[images[stations]]]),
        np.arange(len(known) + len(stations)) < len(known),
        np.concatenate([known, images[stations]]),
    )
