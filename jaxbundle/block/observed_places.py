"""Observed positions of points and stations instead of approximate ones, as the frame for the datum."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.numerics.host import on_host


class Frame(NamedTuple):
    """Points and projection centres relative to the centre of the block, observed ones at their observed positions.

    `radius`: unit of lengths.
    """

    points: Float[np.ndarray, "point 3"]
    centres: Float[np.ndarray, "image 3"]
    centre: Float[np.ndarray, "3"]
    radius: float


def frame_of(block: Block) -> Frame:
    """The positions of a block, observed instead of approximate ones, relative to the centre of the observed ones.

    Centre and radius are medians of the coordinates that define the datum, of all coordinates if these are fewer than
    two positions. So a grossly wrong approximate value does not affect them.
    """
    points, centres, carrying = _observed_places(block)
    everything = np.concatenate([points, centres])
    everything = everything[np.isfinite(everything).all(1)]
    chosen = carrying if len(np.unique(carrying, axis=0)) > 1 else everything
    centre = np.median(chosen, 0) if len(chosen) else np.zeros(3)
    radius = 0.0
    for places in (chosen, everything):
        distances = np.linalg.norm(places - centre, axis=1)
        radius = radius or float(np.median(distances)) if len(places) else radius
        radius = radius or float(distances.max(initial=0.0))
    return Frame(points - centre, centres - centre, centre, radius or 1.0)


def _observed_places(block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and projection centres, with observed instead of approximate coordinates.

    Also the positions that define the datum: points or stations with three observed or fixed coordinates.
    """
    structure = block.structure
    places = {"point": np.array(block.object_points), "image": np.array(block.exterior.projection_centre)}
    carrying = {"point": ~structure.point_free, "image": ~structure.exterior_free[:, :3]}
    for group in block.groups:
        kind = group.structure.kind
        if kind.in_object_system:
            touched = next(k for k, entity in enumerate(kind.touches) if entity in places)
            member, component = np.nonzero(group.structure.observed)
            entity = group.structure.indices[member, touched]
            free = ~carrying[kind.touches[touched]][entity, component]
            values = on_host(group.values)[member, component]
            places[kind.touches[touched]][entity[free], component[free]] = values[free]
    for group in block.groups:
        kind = group.structure.kind
        if kind.in_object_system:
            touched = next(k for k, entity in enumerate(kind.touches) if entity in places)
            member, component = np.nonzero(group.structure.observed)
            carrying[kind.touches[touched]][group.structure.indices[member, touched], component] = True
    found = [places[k][carrying[k].all(1)] for k in places]
    return places["point"], places["image"], np.concatenate(found)


def observed_places(block: Block, frame: Frame) -> list[tuple[str, str, Float[np.ndarray, "3"]]]:
    """Points and images with an observed or fixed coordinate: "point" or "image", name and position in the frame."""
    structure, found = block.structure, []
    for entity, places, names in (
        ("point", frame.points, structure.point_names),
        ("image", frame.centres, structure.image_names),
    ):
        found += [(entity, names[k], places[k]) for k in sorted(_observed_entities(block, entity))]
    return found


def _observed_entities(block: Block, entity: str) -> set[int]:
    """Points or images that have an observed or fixed coordinate."""
    structure = block.structure
    held = ~structure.point_free if entity == "point" else ~structure.exterior_free[:, :3]
    found = set(np.flatnonzero(held.any(1)).tolist())
    for group in block.groups:
        kind = group.structure.kind
        if kind.in_object_system and entity in kind.touches:
            found.update(group.structure.indices[:, kind.touches.index(entity)].tolist())
    return found
