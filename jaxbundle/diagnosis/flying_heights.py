"""Detecting principal distances that are correlated with the flying height.

    r = C_cZ / sqrt(C_cc C_ZZ),    Z = mean of Z0 over the images of a camera

Vertical images of flat terrain determine only the scale c / (Z0 - Z): a common change of c and Z0 leaves no residuals
(Kraus 2007, self-calibration). Relief, convergent images, or observed stations separate them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.depths import viewing_directions
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.wording import figure
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.covariance import covariance_of

HIGH_CORRELATION = 0.95
VERTICAL = 0.966  # cosine of 15 degrees between a camera axis and the vertical
CAMERAS = 3  # maximum number of findings: each image of a collection may have its own camera
ELEMENT = "principal_distance"


def flying_height_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """One finding for each camera whose principal distance is highly correlated with the height of its stations."""
    block = adjustment.block
    cameras = _vertical_cameras(block)
    if adjustment.cofactors is None or adjustment.undetermined or adjustment.reduced == "pcg" or not cameras:
        return ()
    images = [np.flatnonzero(block.structure.image_camera == c) for c in cameras]
    covariance = covariance_of(adjustment, lambda b: _distances_and_heights(b, cameras, images)).covariance
    found = []
    for k, camera in enumerate(cameras):
        own = covariance[k, :, k]
        if own[0, 0] > 0 and own[1, 1] > 0:
            r = float(own[0, 1] / np.sqrt(own[0, 0] * own[1, 1]))
            found += [_finding(block, camera, r, len(images[k]))] if abs(r) > HIGH_CORRELATION else []
    return tuple(found)


def _vertical_cameras(block: Block) -> list[int]:
    """The first cameras with an unknown principal distance and vertical images only, in the datum of control."""
    s = block.structure
    if s.datum.kind != "control":
        return []
    vertical = np.abs(viewing_directions(block)[:, 2]) > VERTICAL
    free = [
        ELEMENT in c.model.elements and s.interior_free[k, c.model.elements.index(ELEMENT)]
        for k, c in enumerate(s.cameras)
    ]
    images = [vertical[s.image_camera == k] for k in range(len(s.cameras))]
    return [k for k, own in enumerate(images) if free[k] and len(own) and own.all()][:CAMERAS]


def _distances_and_heights(
    block: Block, cameras: list[int], images: list[Int[np.ndarray, " _image"]]
) -> Float[Array, "camera 2"]:
    """Joint covariance of c and mean Z0 of each camera."""
    s, shares = block.structure, np.zeros((len(cameras), len(block.structure.image_names)))
    for share, own in zip(shares, images, strict=True):
        share[own] = 1 / len(own)
    places = [s.cameras[c].model.elements.index(ELEMENT) for c in cameras]
    distances = block.interior.elements[np.array(cameras), np.array(places)]
    return jnp.stack([distances, shares @ block.exterior.projection_centre[:, 2]], 1)


def _finding(block: Block, camera: int, r: float, images: int) -> Finding:
    name = block.structure.cameras[camera].name
    what = (
        f"{ELEMENT} of camera {name} and the mean Z0 of its {images} images are correlated by {figure(r, 3)}: vertical"
        " images of such flat terrain hardly separate them, so each absorbs errors of the other"
    )
    cure = "fix it or give it a prior, observe the stations, or add control in relief or convergent images"
    return Finding(Kind.CORRELATED, what, cure, (Subject("cameras", (name,), ELEMENT),), r)
