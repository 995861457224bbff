"""The results of an adjustment as a folder: report.txt, report.json and CSV tables.

There is never a half-written result. A new folder is written beside its place and moved there as a whole. In a folder
that exists, what an earlier adjustment wrote is replaced file by file, report.txt last: where it stands, all the others
belong to it. Nothing else in the folder is touched.
"""

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.camera.fiducials import PARAMETERS, InnerOrientation
from jaxbundle.io.tables import Columns, write_table
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.group_tables import GroupTable, table_names
from jaxbundle.report.tables import dict_of
from jaxbundle.report.text import text_of
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.reliability import reliability

TEXT, DATA = "report.txt", "report.json"


def write_report(adjustment: Adjustment, folder: str | Path) -> Path:
    """Writes all results of a concrete adjustment into a folder and returns its path.

    Raises: FileExistsError where the folder holds files of these names that no adjustment wrote.
    """
    robust = adjustment.reweighting is not None
    target, names = Path(folder), result_files(adjustment.block, robust)
    require_place(target, adjustment.block, robust)
    figures = figures_of(adjustment)
    with _moved_to(target) as place:
        for name, columns in _tables(figures).items():
            write_table(place / name, columns)
        (place / DATA).write_text(_json({**dict_of(figures), "files": names}), encoding="utf-8")
        (place / TEXT).write_text(text_of(figures), encoding="utf-8")
    return target


def result_files(block: Block, robust: bool = False) -> list[str]:
    """Names of the files that a report of this block consists of, report.txt last."""
    parameters = ["parameters.csv"] if block.structure.parameters else []
    check = ["check_points.csv"] if len(block.structure.check_point) else []
    groups = [f"{name}.csv" for name in table_names(block)]
    robust_files = ["down_weighted.csv"] if robust else []
    fiducials = ["inner_orientation.csv", "fiducials.csv"] if block.structure.inner_orientations else []
    always = "images.csv", "cameras.csv", "points.csv", "rays.csv"
    return [*always, *parameters, *groups, *check, *fiducials, *robust_files, DATA, TEXT]


def require_place(folder: str | Path, block: Block, robust: bool = False) -> None:
    """Raises FileExistsError where a report of this block would overwrite what no adjustment wrote."""
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise FileExistsError(f"{target} is a file; give a folder for the results")
    earlier = _earlier_files(target)
    foreign = [name for name in result_files(block, robust) if name not in earlier and (target / name).exists()]
    if foreign:
        raise FileExistsError(
            f"{target} holds {', '.join(foreign)}, which no adjustment wrote; give another folder for the results"
        )


def _earlier_files(target: Path) -> set[str]:
    """What the report.json of an earlier adjustment says that it wrote."""
    try:
        files = json.loads((target / DATA).read_text(encoding="utf-8"))["files"]
        return {name for name in files if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError):
        return set()


@contextmanager
def _moved_to(target: Path) -> Iterator[Path]:
    """A folder to write into, which is moved to the target once all is written."""
    exists = target.is_dir()
    home = target if exists else target.resolve().parent
    home.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".jaxbundle-", dir=home) as temporary:
        place = Path(temporary) / "results"  # within, as only this one gets the permissions of a usual folder
        place.mkdir()
        yield place
        if exists:
            _replace(place, target)
        else:
            place.rename(target)


def _replace(place: Path, target: Path) -> None:
    written = sorted((path.name for path in place.iterdir()), key=lambda name: (name == TEXT, name == DATA, name))
    for name in {TEXT, *_earlier_files(target)} - {DATA, *written[:-1]}:
        (target / name).unlink(missing_ok=True)
    for name in written:
        (place / name).replace(target / name)


def _json(report: dict[str, Any]) -> str:
    """JSON with one line for each image, point and camera."""
    entries = []
    for key, value in report.items():
        if isinstance(value, dict) and any(isinstance(item, dict) for item in value.values()):
            lines = ",\n".join(
                f"  {json.dumps(name)}: {json.dumps(item, allow_nan=False)}" for name, item in value.items()
            )
            entries.append(f" {json.dumps(key)}: {{\n{lines}\n }}")
        else:
            entries.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n" + ",\n".join(entries) + "\n}\n"


def _tables(figures: Figures) -> dict[str, Columns]:
    """All tables by the name of their file."""
    tables = {
        "images.csv": _images(figures),
        "cameras.csv": _cameras(figures),
        "points.csv": _points(figures),
        "rays.csv": _rays(figures),
    }
    if figures.structure.parameters:
        tables["parameters.csv"] = _parameters(figures)
    for table in figures.tables:
        tables[f"{table.name}.csv"] = _group(table)
    if len(figures.structure.check_point):
        tables["check_points.csv"] = _check_points(figures)
    if figures.structure.inner_orientations:
        tables["inner_orientation.csv"] = _inner_orientations(figures.structure.inner_orientations)
        tables["fiducials.csv"] = _fiducials(figures.structure.inner_orientations)
    if figures.weights is not None:
        tables["down_weighted.csv"] = _down_weighted(figures, figures.weights)
    return tables


def _columns(names: tuple[str, ...], values: np.ndarray, prefix: str = "") -> Columns:
    return {prefix + name: column for name, column in zip(names, values.T, strict=True)}


def _images(figures: Figures) -> Columns:
    structure = figures.structure
    cameras = [structure.cameras[c].name for c in structure.image_camera]
    return {
        "image": list(structure.image_names),
        "camera": cameras,
        **_columns(structure.exterior_elements, figures.exterior),
        **_columns(structure.exterior_elements, figures.exterior_sd, "s"),
        "rays": figures.rays_of_image,
    }


def _cameras(figures: Figures) -> Columns:
    structure = figures.structure
    rows = [(c, k) for c, camera in enumerate(structure.cameras) for k in range(len(camera.model.elements))]
    camera, element = np.array(rows).T
    return {
        "camera": [structure.cameras[c].name for c in camera],
        "element": [structure.cameras[c].model.elements[k] for c, k in rows],
        "value": figures.interior[camera, element],
        "sd": figures.interior_sd[camera, element],
    }


def _points(figures: Figures) -> Columns:
    return {
        "point": list(figures.structure.point_names),
        **_columns(("X", "Y", "Z"), figures.points),
        **_columns(("X", "Y", "Z"), figures.points_sd, "s"),
        "rays": figures.rays_of_point,
    }


def _rays(figures: Figures) -> Columns:
    structure, rays = figures.structure, figures.adjustment.block.rays
    return {
        "image": _picked(structure.image_names, structure.ray_image),
        "point": _picked(structure.point_names, structure.ray_point),
        **_columns(("x", "y"), np.asarray(rays.coordinates)),
        **_columns(("x", "y"), np.asarray(rays.sigmas), "s"),
        **_columns(("x", "y"), figures.residuals[0], "v"),
        **_reliability(figures),
    }


def _reliability(figures: Figures) -> Columns:
    """Redundancy numbers and standardised residuals of the rays, where there are any."""
    if figures.adjustment.redundancy_numbers is None:
        return {}
    found = reliability(figures.adjustment)
    return {
        **_columns(("x", "y"), found.redundancy_numbers[0], "r"),
        **_columns(("x", "y"), found.w[0], "w"),
    }


def _picked(names: tuple[str, ...], index: np.ndarray) -> list[str]:
    return [names[k] for k in index.tolist()]


def _group(table: GroupTable) -> Columns:
    return {
        **table.who,
        **_columns(table.components, table.values),
        **_columns(table.components, table.sigmas, "s"),
        **_columns(table.components, table.residuals, "v"),
        **({} if np.isnan(table.r).all() else _columns(table.components, table.r, "r")),
        **({} if np.isnan(table.w).all() else _columns(table.components, table.w, "w")),
    }


def _parameters(figures: Figures) -> Columns:
    """`t` is |value| / sd, empty where it tells nothing."""
    return {
        "parameter": [parameter.name for parameter in figures.structure.parameters],
        "value": figures.parameters,
        "sd": figures.parameters_sd,
        "unit": [parameter.unit for parameter in figures.structure.parameters],
        "t": figures.significance,
    }


def _down_weighted(figures: Figures, weights: np.ndarray) -> Columns:
    structure, rays = figures.structure, figures.down_weighted
    return {
        "image": _picked(structure.image_names, structure.ray_image[rays]),
        "point": _picked(structure.point_names, structure.ray_point[rays]),
        "weight": weights[rays],
        **_columns(("x", "y"), figures.residuals[0][rays], "v"),
    }


def _inner_orientations(fits: tuple[InnerOrientation, ...]) -> Columns:
    """One row an image; parameters that its transformation does not have are empty."""
    worst = [fit.residuals[fit.worst] for fit in fits]
    return {
        "image": [fit.image for fit in fits],
        "transformation": [fit.transformation for fit in fits],
        "fiducials": np.array([len(fit.fiducials) for fit in fits]),
        "redundancy": np.array([fit.redundancy for fit in fits]),
        "sigma0": np.array([fit.sigma0 for fit in fits]),
        "worst": [fit.fiducials[fit.worst] for fit in fits],
        **_columns(("vx", "vy"), np.array(worst)),
        **{name: np.array([fit.parameters.get(name, np.nan) for fit in fits]) for name in PARAMETERS["projective"]},
    }


def _fiducials(fits: tuple[InnerOrientation, ...]) -> Columns:
    """Residuals of the fiducials on every image, mm."""
    return {
        "image": [fit.image for fit in fits for _ in fit.fiducials],
        "fiducial": [name for fit in fits for name in fit.fiducials],
        **_columns(("vx", "vy"), np.concatenate([fit.residuals for fit in fits])),
    }


def _check_points(figures: Figures) -> Columns:
    check = figures.structure.check_point
    return {
        "point": _picked(figures.structure.point_names, check),
        **_columns(("X", "Y", "Z"), figures.points[check]),
        **_columns(("X", "Y", "Z"), figures.points_sd[check], "s"),
        **_columns(("X", "Y", "Z"), figures.check_differences, "d"),
    }
