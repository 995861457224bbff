"""Sections of the unknowns: images, cameras, parameters, points, check points, and fits to fiducials."""

import numpy as np

from jaxbundle.camera.fiducials import PARAMETERS
from jaxbundle.report.figures import Figures
from jaxbundle.report.section import (
    PARAMETER,
    Chapter,
    Facts,
    Picked,
    ReportColumn,
    ReportTable,
    Section,
    decimals,
    digits,
    fact,
    first,
    fixed,
    measured,
    name_column,
    numbers,
    of_page,
    short,
    with_digits,
    with_unit,
)

IMAGES, CAMERAS, POINTS = 200, 50, 50  # rows in the text; the tables contain all
COORDINATES = ("X", "Y", "Z")


def images(figures: Figures) -> Section:
    """A table of the exterior orientations."""
    structure, sd = figures.structure, figures.exterior_sd
    units = [structure.object_unit] * 3 + [structure.angle_unit] * 3
    every = np.arange(len(structure.image_names))
    columns = (
        name_column("image", structure.image_names),
        ReportColumn("camera", Picked(figures.camera_names, structure.image_camera)),
        *measured(structure.exterior_elements, figures.exterior, sd, units, [decimals(column) for column in sd.T]),
        ReportColumn("rays", figures.rays_of_image, "rays", place=1),
    )
    table = ReportTable("images", columns, *first(every, IMAGES, "images"), results=every, below=True, rows=every)
    return Section("Images: adjusted values and standard deviations", (table,), Chapter.IMAGES)


def inner_orientations(figures: Figures) -> Section:
    """A table of the fits of scanned images to their fiducials; parameters of other transformations are empty."""
    fits = figures.structure.inner_orientations
    if not fits:
        return Section("", ())
    five = {"show": lambda value: fixed(value, 5), "place": 0}
    columns = (
        name_column("image", [fit.image for fit in fits]),
        ReportColumn("transformation", [fit.transformation for fit in fits], "transformation", place=0, is_name=True),
        ReportColumn("fiducials", np.array([len(fit.fiducials) for fit in fits]), "fiducials", place=0),
        ReportColumn("redundancy", np.array([fit.redundancy for fit in fits]), "redundancy", place=0),
        ReportColumn("sigma0", np.array([fit.sigma0 for fit in fits]), "sigma0", **five),
        ReportColumn("worst", [fit.fiducials[fit.worst] for fit in fits], "worst", short, 0),
        *(
            ReportColumn(name, np.array([fit.residuals[fit.worst][k] for fit in fits]), name, **five)
            for k, name in enumerate(("vx", "vy"))
        ),
        *(ReportColumn(p, np.array([fit.parameters.get(p, np.nan) for fit in fits])) for p in PARAMETERS["projective"]),
    )
    residuals = (
        ReportColumn("image", [fit.image for fit in fits for _ in fit.fiducials]),
        ReportColumn("fiducial", [name for fit in fits for name in fit.fiducials]),
        *numbers(("vx", "vy"), np.concatenate([fit.residuals for fit in fits])),
    )
    table = ReportTable("inner_orientation", columns, *first(np.arange(len(fits)), IMAGES, "images"))
    entries = {
        fit.image: {
            "transformation": fit.transformation,
            **fit.parameters,
            "redundancy": fit.redundancy,
            "sigma0": fit.sigma0,
            "fiducials": dict(zip(fit.fiducials, fit.residuals.tolist(), strict=True)),
        }
        for fit in fits
    }
    facts = Facts((fact("", "", inner_orientations=entries),), 0)
    fiducials = ReportTable("fiducials", residuals, np.zeros(0, int))
    return Section("Inner orientation: fits to the fiducials, mm", (facts, table, fiducials), Chapter.CAMERAS)


def cameras(figures: Figures) -> Section:
    """A table of the interior elements; the text and report.json have only the estimated ones."""
    structure = figures.structure
    rows = [(c, k) for c, camera in enumerate(structure.cameras) for k in range(len(camera.model.elements))]
    c, k = np.array(rows).T
    value, sd = figures.interior[c, k], figures.interior_sd[c, k]
    names = [structure.cameras[c].model.elements[k] for c, k in rows]
    with np.errstate(all="ignore"):
        ratio = np.where(sd > 0, np.abs(value) / sd, np.nan)
    columns = (
        name_column("camera", Picked(figures.camera_names, c)),
        ReportColumn("element", names, "element", place=0, is_name=True),
        ReportColumn("value", value, "value", with_digits(8), is_result=True),
        ReportColumn("sd", sd, "sd", with_digits(3), deviation_of="value"),
        of_page("unit", [structure.cameras[c].unit_of(name) for (c, _), name in zip(rows, names, strict=True)]),
        of_page("|value|/sd", ratio, lambda t: fixed(t, 1)),
    )
    free = np.flatnonzero(structure.interior_free[c, k])
    shown, more = first(np.unique(c[free]), CAMERAS, "cameras")
    table = ReportTable("cameras", columns, free[np.isin(c[free], shown)], more, free, rows=free)
    nothing = () if len(free) else ("none: all interior elements are fixed",)
    return Section("Cameras: estimated elements", (*nothing, table), Chapter.CAMERAS)


def parameters(figures: Figures) -> Section:
    """A table of parameters; the text has unknown ones, and those fixed at other values than 0. `t`: |value| / sd."""
    structure, given = figures.structure, figures.structure.parameters
    free, sd = structure.parameter_free, figures.parameters_sd
    held = [digits(s, 3) if p.free else "fixed" for p, s in zip(given, sd, strict=True)]
    columns = (
        name_column("parameter", [parameter.name for parameter in given], PARAMETER),
        ReportColumn("value", figures.parameters, "value", with_digits(8), is_result=True),
        ReportColumn("sd", sd, deviation_of="value"),
        of_page("sd", held, place=2),
        ReportColumn("unit", [parameter.unit for parameter in given], "unit", is_result=True),
        ReportColumn("t", figures.significance, "|value|/sd", lambda t: fixed(t, 1), is_result=True),
    )
    shown = first(np.flatnonzero(free | (figures.parameters != 0)), POINTS, "parameters")
    table = ReportTable("parameters", columns, *shown, results=np.arange(len(given)), in_file=bool(given))
    return Section("Parameters", (table,))


def points(figures: Figures) -> Section:
    """A table of the object points; the text and report.json have only those with an unknown coordinate."""
    structure, unknown, sd = figures.structure, figures.unknown_points, figures.points_sd
    units, places = [structure.object_unit] * 3, [decimals(column[unknown]) for column in sd.T]
    columns = (
        name_column("point", structure.point_names),
        *measured(COORDINATES, figures.points, sd, units, places),
        ReportColumn("rays", figures.rays_of_point, "rays", place=1),
    )
    table = ReportTable("points", columns, *first(unknown, POINTS, "points"), results=unknown, rows=unknown)
    before = _precision_of_points(figures) if len(unknown) else ("all coordinates of all points are fixed",)
    return Section("Object points", (*before, table), Chapter.POINTS)


def _precision_of_points(figures: Figures) -> tuple[ReportTable | str, ...]:
    """A summary of the standard deviations of many points: mean and maximum."""
    sd, free = figures.points_sd, figures.structure.point_free
    if not np.isfinite(sd).all():
        return ()
    rms = [np.sqrt(np.mean(column[f] ** 2)) if f.any() else 0.0 for column, f in zip(sd.T, free.T, strict=True)]
    values = zip(COORDINATES, rms, sd.max(0), strict=True)
    columns = (
        name_column("", ["sd, root mean square", "sd, largest"], longest=30),
        *(of_page(with_unit(c, figures.structure.object_unit), np.array(v), with_digits(3)) for c, *v in values),
    )
    return ReportTable("precision", columns, np.arange(2), in_file=False), ""


def check_points(figures: Figures) -> Section:
    """A table of adjusted coordinates of check points, and their differences from the known ones."""
    structure, check, differences = figures.structure, figures.structure.check_point, figures.check_differences
    sd, unit = figures.points_sd[check], figures.structure.object_unit
    places = [decimals(column) for column in sd.T]
    columns = (
        name_column("point", Picked(structure.point_names, check)),
        *measured(COORDINATES, figures.points[check], sd, [unit] * 3, places),
        *(
            ReportColumn(f"d{c}", d, with_unit(f"d{c}", unit), lambda v, p=p: fixed(v, p), 3, is_result=True)
            for c, d, p in zip(COORDINATES, differences.T, places, strict=True)
        ),
    )
    every = np.arange(len(check))
    known = np.isfinite(differences)
    squares = np.where(known, differences, 0.0) ** 2
    rms = np.sqrt(squares.sum(0) / np.maximum(known.sum(0), 1))
    shown = first(every, POINTS, "check points")
    table = ReportTable("check_points", columns, *shown, results=every, in_file=bool(len(check)), rows=every)
    after = f"root mean square  dX {rms[0]:.3g}  dY {rms[1]:.3g}  dZ {rms[2]:.3g}  {unit}"
    parts = (table, after) if len(check) else (table,)
    return Section("Check points: adjusted - known", parts, Chapter.CONTROL)


def fixed_points(figures: Figures) -> Facts | None:
    """Facts about control points with fixed coordinates."""
    free, names = figures.structure.point_free, figures.structure.point_names
    rows = np.flatnonzero(~free.all(1))
    axes = np.array(COORDINATES)
    held = [f"{names[p]} ({', '.join(axes[~free[p]])})" if free[p].any() else names[p] for p in rows[:POINTS]]
    more = f" and {len(rows) - POINTS} more" if len(rows) > POINTS else ""
    return Facts((fact("Fixed:", ", ".join(held) + more),), 10) if held else None
