"""Checking before the adjustment whether the control of a strip is sufficient for its polynomials.

Polynomials of degree n need n + 1 bands of control across the strip, from its begin to its end, and in each band a
point near each edge, for the torsion of the strip. Two points that tie an edge to another strip replace a control
point; an observed projection centre in a band replaces one of its edges.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.block.wording import figure

EDGE = 0.3  # share of half of the width: farther points are near the edge
TIES = 2  # number of points that tie an edge to another strip
BANDS = {
    3: ("at its begin", "in its middle", "at its end"),
    4: ("at its begin", "in its second", "in its third", "at its end"),
}


class Supported(NamedTuple):
    """Points that support a strip: positions relative to half of the length and the width, and their type."""

    along: Float[np.ndarray, " point"]
    across: Float[np.ndarray, " point"]
    control: Bool[np.ndarray, " point"]
    """Mask of control in X, Y and Z."""
    tie: Bool[np.ndarray, " point"]
    """Mask of points that another strip also sees."""
    stations: Float[np.ndarray, " image"]
    """Positions of observed projection centres along the strip."""


def full_control(block: Block) -> Bool[np.ndarray, " point"]:
    """Mask of points with three fixed or observed coordinates."""
    known = np.array(~block.structure.point_free)
    for group in block.groups:
        if group.structure.kind == CONTROL:
            known[group.structure.indices[:, 0]] |= group.structure.observed
    return np.asarray(known.all(1))


def observed_stations(block: Block) -> Bool[np.ndarray, " image"]:
    """Mask of images with an observed or fixed projection centre."""
    known = np.array((~block.structure.exterior_free[:, :3]).all(1))
    for group in block.groups:
        kind = group.structure.kind
        if kind.table == "stations" and kind.touches[0] == "image":
            known[group.structure.indices[:, 0]] |= group.structure.observed.all(1)
    return known


def missing_control(name: str, s: Supported, bands: int, images: tuple[str, ...] = ()) -> list[Finding]:
    """Findings about unsupported bands and edges of a strip. `images`: the images at its ends."""
    limits = np.linspace(-1, 1, bands + 1)
    limits[0], limits[-1] = -np.inf, np.inf
    found = []
    for k, where in enumerate(BANDS[bands]):
        inside = (s.along >= limits[k]) & (s.along < limits[k + 1])
        here = ((s.stations >= limits[k]) & (s.stations < limits[k + 1])).any()
        edges = {"left": s.across > EDGE, "right": s.across < -EDGE}
        open_edges = [
            edge
            for edge, mask in edges.items()
            if not (s.control & inside & mask).any() and (s.tie & inside & mask).sum() < TIES
        ]
        if not open_edges or (here and len(open_edges) == 1):
            continue
        edge = "on both edges" if len(open_edges) == 2 else f"on the {open_edges[0]} edge"
        band = where if bands == 3 or k in (0, 3) else f"{where} quarter"
        what = f"{name} has no control {edge} {band}, which polynomials of degree {bands - 1} need"
        cure = "add points with X, Y, Z there, or adjust by models"
        found.append(Finding(Kind.WEAK, what, cure, tuple(Subject("images", (image,)) for image in images)))
    return found


def swinging(name: str, terms: list[str], end: float, unit: str, images: tuple[str, ...] = ()) -> Finding:
    """The finding about coefficients that only their expected sizes determine.

    `end`: the expected error; `images`: at the ends.
    """
    what = f"{name}: {', '.join(terms)} are determined by the expected errors of the strip and not by control"
    cure = f"add control inside the strip; there its points may be wrong by {figure(end, 2)} {unit}"
    return Finding(Kind.WEAK, what, cure, tuple(Subject("images", (image,)) for image in images), end, unit)
