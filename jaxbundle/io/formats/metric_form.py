"""Converting a block for formats of aerial triangulation: cameras in mm from the image centre, y up, no distortion.

px become mm by the pixel size, or by a nominal size for a camera without one. The principal point is unchanged.
"""

import dataclasses

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.io.formats.collected import mm_camera
from jaxbundle.io.formats.foreign_block import ForeignBlock, element
from jaxbundle.io.formats.written import NOMINAL_PIXEL, foreign_block, in_pixels, is_free


def in_mm(block: Block) -> tuple[ForeignBlock, list[str]]:
    """The block in mm, and sentences about what that changes."""
    own, written = foreign_block(block), in_pixels(block, is_free)
    foreign = written.foreign
    losses = [words for words in written.losses if "mm are written" not in words]
    cameras, xy = [], foreign.rays.xy.copy()
    of_ray = foreign.images.camera[foreign.rays.image]
    for k, (camera, original) in enumerate(zip(foreign.cameras, own.cameras, strict=True)):
        size = element(original, "pixel_size") if original.image_unit == "px" else NOMINAL_PIXEL
        if size == 1.0:
            size = NOMINAL_PIXEL
            losses.append(f"camera {camera.name}: px are written as mm of {size} mm per px")
        middle = np.array([camera.width or 0, camera.height or 0]) / 2
        point = (np.array([element(camera, "x0"), element(camera, "y0")]) - middle) * [size, -size]
        cameras.append(mm_camera(camera.name, element(camera, "principal_distance") * size, *point.tolist()))
        xy[of_ray == k] = (xy[of_ray == k] - middle) * [size, -size]
    return dataclasses.replace(foreign, cameras=tuple(cameras), rays=foreign.rays._replace(xy=xy)), losses
