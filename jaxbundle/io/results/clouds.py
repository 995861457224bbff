"""Writing object points as a cloud: PLY, and LAS or LAZ with standard deviations as extra dimensions.

PLY is binary_little_endian: x, y, z double, red, green, blue uchar, rays int, class uchar; of an adjustment sX, sY, sZ
and largest_w float too. LAS is version 1.4, point format 2, with a scale of 0.001; its coordinate system is that of the
block where it is known.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.io.formats.coordinates import crs_of, is_metric_local
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.results.map_features import Features
from jaxbundle.io.results.system import system_of
from jaxbundle.numerics.whole_files import write_whole

ROUND = 1000.0  # an offset is a multiple of it: single precision, as viewers have it, then leaves 0.1 mm and better
COLOURS = (128, 128, 128), (0, 90, 156), (196, 80, 11)  # tie, control and check points, as in the report
NAMES = {"<f8": "double", "<f4": "float", "<i4": "int", "u1": "uchar"}
LAS_SCALE = 0.001  # object unit
SIGMAS = ("sX", "sY", "sZ")


def offset_of(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "3"]:
    """What is taken off the coordinates of a PLY file, for viewers have them in single precision."""
    usable = np.isfinite(points).all(1)
    middle = points[usable].mean(0) if usable.any() else np.zeros(3)
    return np.round(middle / ROUND) * ROUND + 0.0  # no -0


def write_ply(features: Features, path: Path) -> None:
    """Writes the object points that have finite coordinates, less an offset that a comment names."""
    fields = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    fields += [(name, "<f4") for name in SIGMAS] if features.sigmas is not None else []
    fields += [("rays", "<i4"), ("class", "u1")] + ([("largest_w", "<f4")] if features.largest is not None else [])
    usable, offset = np.isfinite(features.points).all(1), offset_of(features.points)
    data = np.zeros(int(usable.sum()), fields)
    for k, axis in enumerate("xyz"):
        data[axis] = features.points[usable, k] - offset[k]
        data[("red", "green", "blue")[k]] = np.array(COLOURS, np.uint8)[features.role[usable], k]
        if features.sigmas is not None:
            data[SIGMAS[k]] = features.sigmas[usable, k]
    data["rays"], data["class"] = features.rays[usable], features.role[usable]
    if features.largest is not None:
        data["largest_w"] = features.largest[usable]
    comments = [
        told_offset(offset),
        f"points without finite coordinates left out: {int((~usable).sum())}",
        "class: 0 tie point, 1 control point, 2 check point",
        "largest_w: maximum |w| / sigma0 of the rays",
    ]
    lines = [f"element vertex {len(data)}", *(f"property {NAMES[kind]} {name}" for name, kind in fields)]
    content = ply_header(comments, lines, "binary_little_endian") + data.tobytes()
    write_whole(path, lambda file: file.write(content))


def told_offset(offset: Float[np.ndarray, "3"]) -> str:
    """The comment that names an offset."""
    return "offset to be added: " + " ".join(f"{value:.0f}" for value in offset)


def ply_header(comments: list[str], lines: list[str], form: str) -> bytes:
    """The head of a PLY file."""
    words = ["ply", f"format {form} 1.0", *(f"comment {words}" for words in comments), *lines, "end_header"]
    return ("\n".join(words) + "\n").encode("ascii", "replace")


def write_las(features: Features, path: Path) -> None:
    """Writes the object points as LAS, or LAZ by the suffix.

    Raises: BlockError where laspy is not installed.
    """
    laspy = extra("laspy", f"writing {path.name}")
    if path.suffix.lower() == ".laz":
        extra("lazrs", f"writing {path.name}")
    header = laspy.LasHeader(version="1.4", point_format=2)
    header.scales = np.full(3, LAS_SCALE)
    header.offsets = np.floor(features.points.min(0)) if len(features.points) else np.zeros(3)
    if features.sigmas is not None:
        header.add_extra_dims([laspy.ExtraBytesParams(name=name, type=np.float32) for name in SIGMAS])
    system = system_of(features.block)
    if system and not is_metric_local(system):
        header.add_crs(crs_of(system))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = features.points.T
    if features.sigmas is not None:
        for k, name in enumerate(SIGMAS):
            cloud[name] = features.sigmas[:, k].astype(np.float32)
    cloud.write(str(path))
