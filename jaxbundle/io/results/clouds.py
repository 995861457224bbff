"""Writing object points as a cloud: PLY, and LAS or LAZ with standard deviations as extra dimensions.

PLY is binary_little_endian with x, y, z double, red, green, blue uchar, and sX, sY, sZ float and rays int. LAS is
version 1.4, point format 2, with a scale of 0.001; it has the coordinate system of the block where that is known.
"""

from pathlib import Path

import numpy as np

from jaxbundle.io.formats.coordinates import crs_of, is_metric_local
from jaxbundle.io.formats.extras import extra
from jaxbundle.io.results.map_features import Features
from jaxbundle.io.results.system import system_of

GREY = 128
LAS_SCALE = 0.001  # object unit
SIGMAS = ("sX", "sY", "sZ")


def write_ply(features: Features, path: Path) -> None:
    """Writes the object points as PLY."""
    fields = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    names = {"<f8": "double", "u1": "uchar", "<f4": "float", "<i4": "int"}
    if features.sigmas is not None:
        fields += [(name, "<f4") for name in SIGMAS]
    fields.append(("rays", "<i4"))
    data = np.zeros(len(features.points), fields)
    for k, axis in enumerate("xyz"):
        data[axis] = features.points[:, k]
    for colour in ("red", "green", "blue"):
        data[colour] = GREY
    if features.sigmas is not None:
        for k, name in enumerate(SIGMAS):
            data[name] = features.sigmas[:, k]
    data["rays"] = features.rays
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(data)}"]
    head += [f"property {names[kind]} {name}" for name, kind in fields] + ["end_header", ""]
    path.write_bytes("\n".join(head).encode() + data.tobytes())


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
