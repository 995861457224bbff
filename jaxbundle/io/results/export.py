"""Writing results to a file; its suffix determines the format."""

from collections.abc import Callable
from pathlib import Path

from jaxbundle.block.block import Block
from jaxbundle.io.results.clouds import write_las, write_ply
from jaxbundle.io.results.drawing import write_dxf
from jaxbundle.io.results.map_features import Features, features_of
from jaxbundle.io.results.maps import write_geojson, write_geopackage, write_kml
from jaxbundle.solve.adjustment import Adjustment

EXPORTS: dict[str, Callable[[Features, Path], None]] = {
    ".ply": write_ply,
    ".las": write_las,
    ".laz": write_las,
    ".geojson": write_geojson,
    ".gpkg": write_geopackage,
    ".kml": write_kml,
    ".dxf": write_dxf,
}


def export(result: Block | Adjustment, path: str | Path) -> None:
    """Writes points, images, residual vectors and error ellipses for display in other programs.

    Args:
        result: an adjustment, or a block, which has no standard deviations.
        path: the file; its suffix determines the format: .ply, .las, .laz, .geojson, .gpkg, .kml or .dxf.

    Raises: ValueError for another suffix; FileExistsError where the file exists; BlockError where a package is missing
    or the coordinate system that a format needs is unknown.

    Example:

        >>> jb.export(result, "points.ply")
    """
    path = Path(path)
    if not isinstance(result, Block | Adjustment):
        raise TypeError(f"export takes a Block or an Adjustment, not {type(result).__name__}")
    write = EXPORTS.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"{path.name} has no known suffix; known: {', '.join(EXPORTS)}")
    if path.exists():
        raise FileExistsError(f"{path} exists; give another name")
    write(features_of(result), path)
