"""Writing points and stations as PLY, for viewers of point clouds such as CloudCompare and MeshLab."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.io.results.clouds import offset_of, ply_header, told_offset, write_ply
from jaxbundle.io.results.map_features import features_of
from jaxbundle.numerics.whole_files import write_whole
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.pictures.known import known
from jaxbundle.report.pictures.ray_pictures import image_format
from jaxbundle.solve.adjustment import Adjustment

FRUSTUM = 0.08  # height of the pyramid of an image as a share of the distance to its points


def to_ply(result: Adjustment, path: str | Path, stations: str | Path | None = None) -> Path:
    """Writes the object points of a result as a binary PLY file, and its stations as another one.

    Args:
        result: a concrete adjustment.
        path: file of the points, as `export` writes it: coordinates less the offset that a comment names, standard
            deviations, all in the object unit, number of rays, class (0 tie, 1 control, 2 check point), and the largest
            |w| / sigma0 of the rays.
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
    target = Path(path)
    write_ply(features_of(result), target)
    if stations is not None:
        with np.errstate(all="ignore"):
            figures = figures_of(result, ())
        content = _stations(result, figures, offset_of(figures.points))
        write_whole(Path(stations), lambda file: file.write(content))
    return target


def _stations(result: Adjustment, figures: Figures, offset: np.ndarray) -> bytes:
    """A pyramid for each image: its projection centre, and the corners of its format towards the object."""
    rotation = np.asarray(unknowns_of(result.block).rotation).T.reshape(-1, 3, 3)
    centres = known(figures.exterior[:, :3])
    distance = np.linalg.norm(np.nanmean(known(figures.points), 0) - np.nanmean(centres, 0))
    vertices, edges = [], []
    for k in np.flatnonzero(np.isfinite(centres).all(1)).tolist():
        rays = format_corners(figures, int(figures.structure.image_camera[k])) @ rotation[k].T
        first = len(vertices)
        vertices += [centres[k] - offset, *(centres[k] - offset + FRUSTUM * distance * rays)]
        edges += [(first, first + n) for n in (1, 2, 3, 4)]
        edges += [(first + n, first + n % 4 + 1) for n in (1, 2, 3, 4)]
    lines = [f"element vertex {len(vertices)}", *(f"property double {axis}" for axis in "xyz")]
    lines += [f"element edge {len(edges)}", "property int vertex1", "property int vertex2"]
    body = [" ".join(f"{value:.6f}" for value in vertex) for vertex in vertices]
    body += [f"{a} {b}" for a, b in edges]
    return ply_header([told_offset(offset)], lines, "ascii") + ("\n".join(body) + "\n").encode("ascii")


def format_corners(figures: Figures, camera: int) -> Float[np.ndarray, "4 3"]:
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
