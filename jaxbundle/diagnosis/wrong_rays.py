"""Rays that keep a block from converging, or bend it beyond any use: found by robust weights from the start.

A robust adjustment takes the weight of gross errors round by round (solve/robust.py). Where it converges and fits, the
rays that lost their weight are what was wrong: single ones, two whose names are exchanged, or whole images.
"""

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.diagnosis.wording import counted, figure, named, ray_name, ray_subject
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment, Status
from jaxbundle.solve.attempt import attempt
from jaxbundle.solve.robust import Danish
from jaxbundle.statistics.hypotheses import image_points

CURED = 0.3  # of sigma0, left by the robust weights
MOST_WRONG = 0.1  # share of the rays: if more lose their weight, the robust weights have chosen the wrong side
WHOLE_IMAGE = 0.5  # share of its rays from which on an image is named in their place
ITERATIONS = 50  # of an adjustment between two rounds
SAME_PLACE = 0.1  # of the distance of two image points: their names fit if exchanged


def wrong_rays(start: Block, adjustment: Adjustment) -> tuple[Finding, ...]:
    """Rays or images without which the block converges; nothing where robust weights do not cure it."""
    robust = attempt(start, robust=Danish(), max_iterations=ITERATIONS)
    if robust is None or robust.reweighting is None:
        return ()
    weights, after = np.asarray(robust.reweighting.weights), float(robust.sigma0)
    low = np.flatnonzero(weights < DOWN_WEIGHTED)
    cured = after <= CURED * float(adjustment.sigma0) or adjustment.status is not Status.CONVERGED
    if not cured or not 0 < len(low) <= MOST_WRONG * len(weights):
        return ()
    v = np.asarray(robust.residuals[0])
    low = low[np.argsort(-np.linalg.norm(v[low], axis=1), kind="stable")]
    images, low = _whole_images(start, low)
    pairs, low = _exchanged(start, low, v)
    left = f"without what is named here the adjustment converges with sigma0 {after:.4g}"
    return (
        *(_image(start, image, left) for image in images),
        *(_pair(start, pair, left) for pair in pairs),
        *([_single(start, low, v, left)] if len(low) else []),
    )


def _whole_images(start: Block, low: Int[np.ndarray, " ray"]) -> tuple[list[int], Int[np.ndarray, " ray"]]:
    """Images of which most rays are wrong, and the wrong rays of the others."""
    structure, count = start.structure, len(start.structure.image_names)
    rays, wrong = (np.bincount(x, minlength=count) for x in (structure.ray_image, structure.ray_image[low]))
    whole = wrong > WHOLE_IMAGE * np.maximum(rays, 1)
    return np.flatnonzero(whole).tolist(), low[~whole[structure.ray_image[low]]]


def _exchanged(
    start: Block, low: Int[np.ndarray, " ray"], v: Float[np.ndarray, "ray 2"]
) -> tuple[list[tuple[int, int]], Int[np.ndarray, " ray"]]:
    """Pairs of rays of one image of which each was measured where the other one is computed; and the other rays."""
    x, image = image_points(start), start.structure.ray_image
    pairs: list[tuple[int, int]] = []
    left = low.tolist()
    while left:
        a = left.pop(0)
        for b in [b for b in left if image[b] == image[a]]:
            apart = x[b] - x[a]
            tolerance = SAME_PLACE * np.linalg.norm(apart)
            if max(np.linalg.norm(v[a] - apart), np.linalg.norm(v[b] + apart)) < tolerance:
                pairs.append((a, b))
                left.remove(b)
                break
    taken = {ray for pair in pairs for ray in pair}
    return pairs, np.array([ray for ray in low.tolist() if ray not in taken], int)


def _image(start: Block, image: int, left: str) -> Finding:
    name = start.structure.image_names[image]
    cure = "check its camera, its resolution and its name, or remove it"
    what = f"most rays of image {name} do not agree with the other images; {left}"
    return Finding(Kind.SUSPECT, what, cure, (Subject("images", (name,)),))


def _pair(start: Block, pair: tuple[int, int], left: str) -> Finding:
    one, two = (ray_subject(start.structure, ray) for ray in pair)
    what = f"the names of points {one.names[1]} and {two.names[1]} are exchanged on image {one.names[0]}; {left}"
    return Finding(Kind.SUSPECT, what, "exchange them back", (one, two))


def _single(start: Block, rays: Int[np.ndarray, " ray"], v: Float[np.ndarray, "ray 2"], left: str) -> Finding:
    """The worst rays, those that disagree most first."""
    structure = start.structure
    size = np.linalg.norm(v[rays], axis=1)
    unit = structure.cameras[structure.image_camera[structure.ray_image[rays[0]]]].image_unit
    listed = named([f"{ray_name(structure, r)} ({figure(s)} {unit})" for r, s in zip(rays.tolist(), size, strict=True)])
    verb = "disagrees" if len(rays) == 1 else "disagree"
    what = f"{counted(len(rays), 'ray')} {verb} with the others: {listed}; {left}"
    subjects = tuple(ray_subject(structure, ray) for ray in rays.tolist())
    return Finding(Kind.SUSPECT, what, "measure them again or remove them", subjects, float(size[0]), unit)
