"""Observed positions of points and stations instead of approximate ones, as the frame for the datum."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.numerics.host import on_device, on_host


class Frame(NamedTuple):
    """The block relative to its centre, observed objects at observed positions; `radius`: unit of lengths."""

    block: Block
    centre: Float[np.ndarray, "3"]
    radius: float


def frame_of(block: Block) -> Frame:
    """The block with observed instead of approximate coordinates, relative to the centre of the observed ones.

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
    placed = eqx.tree_at(lambda b: (b.object_points, b.exterior.projection_centre), block, on_device((points, centres)))
    return Frame(placed.moved(-centre), centre, radius or 1.0)


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


def observed_places(block: Block) -> list[tuple[str, str, Float[np.ndarray, "3"]]]:
    """Points and images with an observed or fixed coordinate: "point" or "image", name and position."""
    structure = block.structure
    points, centres, _ = _observed_places(block)
    found = []
    for entity, places, names in (("point", points, structure.point_names), ("image", centres, structure.image_names)):
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
