"""The tables of a report: columns of names and numbers, one row per image, point, ray or other observation."""

from collections.abc import Callable
from functools import partial

import numpy as np

from jaxbundle.camera.fiducials import PARAMETERS
from jaxbundle.io.tables import Columns
from jaxbundle.report.figures import Figures
from jaxbundle.report.group_tables import GroupTable
from jaxbundle.statistics.reliability import reliability


def tables_of(figures: Figures) -> dict[str, Callable[[Figures], Columns]]:
    """Every table by the name of its file, as a function that makes it."""
    structure = figures.structure
    tables: dict[str, Callable[[Figures], Columns]] = {
        "images.csv": _images,
        "cameras.csv": _cameras,
        "points.csv": _points,
        "rays.csv": _rays,
    }
    if structure.parameters:
        tables["parameters.csv"] = _parameters
    for table in figures.tables:
        tables[f"{table.name}.csv"] = partial(_group, table)
    if len(structure.check_point):
        tables["check_points.csv"] = _check_points
    if structure.inner_orientations:
        tables["inner_orientation.csv"] = _inner_orientations
        tables["fiducials.csv"] = _fiducials
    if figures.weights is not None:
        tables["down_weighted.csv"] = _down_weighted
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


def _group(table: GroupTable, figures: Figures) -> Columns:
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


def _down_weighted(figures: Figures) -> Columns:
    structure, rays, weights = figures.structure, figures.down_weighted, figures.weights
    assert weights is not None
    return {
        "image": _picked(structure.image_names, structure.ray_image[rays]),
        "point": _picked(structure.point_names, structure.ray_point[rays]),
        "weight": weights[rays],
        **_columns(("x", "y"), figures.residuals[0][rays], "v"),
    }


def _inner_orientations(figures: Figures) -> Columns:
    """One row per image; parameters that its transformation does not have are empty."""
    fits = figures.structure.inner_orientations
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


def _fiducials(figures: Figures) -> Columns:
    """Residuals of the fiducials on every image, mm."""
    fits = figures.structure.inner_orientations
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
