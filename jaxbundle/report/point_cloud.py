"""Writing points and stations as PLY, for viewers of point clouds such as CloudCompare and MeshLab."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.numerics.whole_files import write_whole
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.pictures.known import known
from jaxbundle.report.pictures.plan_picture import plan
from jaxbundle.report.pictures.ray_pictures import image_format, standardised
from jaxbundle.solve.adjustment import Adjustment

ROUND = 1000.0  # offsets are multiples of it: the single precision of viewers then resolves 0.1 mm or better
FRUSTUM = 0.08  # height of the pyramid of an image as a share of the distance to its points
POINT = np.dtype(
    [
        *((name, "<f8") for name in ("x", "y", "z")),
        *((name, "<f4") for name in ("sd_x", "sd_y", "sd_z")),
        ("rays", "<i4"),
        ("max_w", "<f4"),
        ("class", "u1"),
    ]
)
TYPES = {"<f8": "double", "<f4": "float", "<i4": "int", "|u1": "uchar"}


def to_ply(result: Adjustment, path: str | Path, stations: str | Path | None = None) -> Path:
    """Writes the object points of a result as a binary PLY file, and its stations as another one.

    Args:
        result: a concrete adjustment.
        path: file of the points: coordinates minus the offset that a comment contains, standard deviations, all in the
            object unit, number of rays, maximum |w| / sigma0 of the rays, and class (0 tie, 1 control, 2 check point).
        stations: file of the stations as pyramids of edges; none if None.

    Returns: the path of the points.

    Raises: TypeError for other objects; OSError where a file cannot be written.

    Example:
        >>> _ = jb.report.to_ply(result, "points.ply", stations="stations.ply")
        >>> Path("points.ply").read_bytes()[:3]
        b'ply'
    """
    require_a(Adjustment, result, "report.to_ply")
    require_photographs(result.block, "report.to_ply")
    with np.errstate(all="ignore"):
        figures = figures_of(result, ())
    seen = plan(figures)
    usable = np.asarray(np.isfinite(seen.points).all(1))
    middle = seen.points[usable].mean(0) if usable.any() else np.zeros(3)
    offset = np.round(middle / ROUND) * ROUND + 0.0  # no -0
    largest = np.zeros(len(usable))
    size = np.nan_to_num(np.abs(standardised(figures))).max(1, initial=0.0)
    np.maximum.at(largest, figures.structure.ray_point, size)
    rows = np.zeros(int(usable.sum()), POINT)
    for k, axis in enumerate("xyz"):
        rows[axis] = seen.points[usable, k] - offset[k]
        rows[f"sd_{axis}"] = figures.points_sd[usable, k]
    rows["rays"], rows["max_w"] = figures.rays_of_point[usable], largest[usable]
    rows["class"] = seen.role[usable]
    left_out = int((~usable).sum())
    comments = [_offset(offset), f"points without finite coordinates left out: {left_out}"]
    comments.append("class: 0 tie point, 1 control point, 2 check point")
    lines = [f"property {TYPES[POINT[name].str]} {name}" for name in POINT.names or ()]
    header = _header(comments, [f"element vertex {len(rows)}", *lines], "binary_little_endian")
    target = Path(path)
    write_whole(target, lambda file: file.write(header + rows.tobytes()))
    if stations is not None:
        content = _stations(result, figures, offset)
        write_whole(Path(stations), lambda file: file.write(content))
    return target


def _offset(offset: np.ndarray) -> str:
    return "offset to be added: " + " ".join(f"{value:.0f}" for value in offset)


def _header(comments: list[str], lines: list[str], form: str) -> bytes:
    words = ["ply", f"format {form} 1.0", *(f"comment {words}" for words in comments), *lines, "end_header"]
    return ("\n".join(words) + "\n").encode("ascii", "replace")


def _stations(result: Adjustment, figures: Figures, offset: np.ndarray) -> bytes:
    """A pyramid for each image: its projection centre, and the corners of its format towards the object."""
    rotation = np.asarray(unknowns_of(result.block).rotation).T.reshape(-1, 3, 3)
    centres = known(figures.exterior[:, :3])
    distance = np.linalg.norm(np.nanmean(known(figures.points), 0) - np.nanmean(centres, 0))
    vertices, edges = [], []
    for k in np.flatnonzero(np.isfinite(centres).all(1)).tolist():
        rays = _corners(figures, int(figures.structure.image_camera[k])) @ rotation[k].T
        first = len(vertices)
        vertices += [centres[k] - offset, *(centres[k] - offset + FRUSTUM * distance * rays)]
        edges += [(first, first + n) for n in (1, 2, 3, 4)]
        edges += [(first + n, first + n % 4 + 1) for n in (1, 2, 3, 4)]
    lines = [f"element vertex {len(vertices)}", *(f"property double {axis}" for axis in "xyz")]
    lines += [f"element edge {len(edges)}", "property int vertex1", "property int vertex2"]
    body = [" ".join(f"{value:.6f}" for value in vertex) for vertex in vertices]
    body += [f"{a} {b}" for a, b in edges]
    return _header([_offset(offset)], lines, "ascii") + ("\n".join(body) + "\n").encode("ascii")


def _corners(figures: Figures, camera: int) -> Float[np.ndarray, "4 3"]:
    """Directions to the corners of the format in the system of the photograph, without distortion, of depth 1."""
    one, values = figures.structure.cameras[camera], figures.interior[camera]
    element = dict(zip(one.model.elements, values.tolist(), strict=False))
    left, low, right, high = image_format(figures, camera)
    size = element.get("pixel_size", 1.0) if one.principal_distance_in_mm else 1.0
    up = -1.0 if one.image_unit == "px" else 1.0
    c = element.get("principal_distance", element.get("f", 1.0)) or 1.0
    xy = np.array([(left, low), (right, low), (right, high), (left, high)])
    reduced = (xy - [element.get("x0", 0.0), element.get("y0", 0.0)]) * size * [1.0, up] / abs(c)
    return np.hstack([reduced, np.full((4, 1), -1.0)])
