"""The report as plain text: problems and suggestions first, then the figures."""

import textwrap
from collections.abc import Sequence

import numpy as np

from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a
from jaxbundle.block.observations import CONTROL
from jaxbundle.diagnosis.elements import HIGH_CORRELATION, correlated_parameters
from jaxbundle.diagnosis.sigmas import global_test
from jaxbundle.report.columns import (
    NAME,
    WIDTH,
    aligned,
    decimals,
    deviation,
    fixed,
    short,
    table,
    with_unit,
    wrapped,
)
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.group_tables import GroupTable
from jaxbundle.report.reliability_table import reliability_lines
from jaxbundle.report.tables import inner_constraints
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment

IMAGES, CAMERAS, POINTS, WORST = 200, 50, 50, 20  # shown of each; the tables hold all
PARAMETER, OWNER = 36, 26  # characters of a parameter's name, of one beside two ends


def report_text(adjustment: Adjustment) -> str:
    """The report of a concrete adjustment, ASCII, at most 110 columns."""
    require_a(Adjustment, adjustment, "report_text")
    return text_of(figures_of(adjustment))


def text_of(figures: Figures) -> str:
    """`report_text` from numbers that are converted already."""
    structure = figures.structure
    sections: list[tuple[str, list[str]]] = [
        ("Verdict", [*wrapped("", _verdict(figures), 2), *finding_lines(figures.findings)]),
        ("Adjustment", _adjustment(figures)),
        ("Observations", _observations(figures)),
        ("Images: adjusted value and standard deviation below", _images(figures)),
        ("Inner orientation: fits to the fiducials, mm", _inner_orientations(figures)),
        ("Cameras: estimated elements", _cameras(figures)),
        ("Parameters", _parameters(figures)),
        ("Object points", _points(figures)),
        *_control(figures),
        *((_title(other), _group(figures, other)) for other in figures.tables if other.name != CONTROL.name),
        ("Check points: adjusted less known", _check_points(figures)),
        (f"Rays of a robust weight below {DOWN_WEIGHTED:g}", _down_weighted(figures)),
        (f"Rays of the largest {_size_of_rays(figures)}", _worst_rays(figures)),
        ("Reliability", reliability_lines(figures)),
        (f"Correlations over {HIGH_CORRELATION}", _correlations(figures)),
    ]
    title = f"Adjustment of block {structure.name or '(unnamed)'}"
    lines = [*textwrap.wrap(title, WIDTH), *textwrap.wrap(structure.source, WIDTH)]
    for name, body in sections:
        if body:
            lines += ["", name, "-" * len(name), *body]
    return "\n".join(line.rstrip() for line in lines).encode("ascii", "replace").decode() + "\n"


def _verdict(figures: Figures) -> str:
    return f"The adjustment {figures.adjustment.verdict}."


def finding_lines(found: Sequence[Finding]) -> list[str]:
    """Findings as lines of text."""
    return [line for finding in found for line in wrapped(finding.severity.label, finding.words, 14)]


def _adjustment(figures: Figures) -> list[str]:
    adjustment, structure = figures.adjustment, figures.structure
    n = adjustment.iterations
    test = global_test(figures.sigma0, adjustment.redundancy)
    free = structure.exterior_free, structure.interior_free, structure.parameter_free, structure.point_free
    exterior, interior, parameters, points = (int(mask.sum()) for mask in free)
    unknown = f"images {exterior}, cameras {interior}, "
    unknown += f"parameters {parameters}, " if structure.parameters else ""
    inner = inner_constraints(structure)
    verdict = "passed" if test.passed else "not passed"
    figure = [
        ("Block", _counts(figures)),
        ("Observations M", f"{adjustment.observations}"),
        ("Unknowns N", f"{adjustment.unknowns} ({unknown}points {points})"),
        *([("Constraints C", f"{inner}")] if inner else []),
        (f"Redundancy M - N{' + C' if inner else ''}", f"{adjustment.redundancy}"),
        ("Datum", str(structure.datum)),
        *_robust(figures),
        ("vTPv", f"{2 * float(n.initial_cost):.8g} at the start, {figures.vtpv:.8g} at the end"),
        ("sigma0", f"{figures.sigma0:.6g} a posteriori, 1 a priori"),
        (
            "Global test",
            f"{verdict}: {test.lower:.4f} < sigma0 < {test.upper:.4f} expected (chi-square, two-sided, 5 %)",
        ),
        ("Iterations", f"{int(n.trials)}, of which {int(n.accepted)} accepted; {adjustment.method}"),
        ("End", f"{adjustment.status.words}; {_last_step(figures)}"),
    ]
    return [line for label, text in figure for line in wrapped(label, text, 23)]


def _last_step(figures: Figures) -> str:
    """What the stopping rule measured last; 0 where the step moved nothing but rounding."""
    measure, rule = float(figures.adjustment.iterations.measure), figures.adjustment.stopping_rule
    return f"stopping rule '{rule}', last step {'below rounding' if measure == 0 else f'{measure:.1e}'}"


def _robust(figures: Figures) -> list[tuple[str, str]]:
    robust = figures.adjustment.reweighting
    if robust is None:
        return []
    low = f"{len(figures.down_weighted)} of {len(figures.structure.ray_image)} rays below {DOWN_WEIGHTED:g}"
    return [("Robust weights", f"{robust.name}, limit {robust.limit:g}; {low} after {robust.rounds} rounds")]


def _counts(figures: Figures) -> str:
    structure = figures.structure
    counts = {
        "images": len(structure.image_names),
        "cameras": len(structure.cameras),
        "object points": len(structure.point_names),
        "control points": int(figures.control_point.sum()),
        "check points": len(structure.check_point),
        "rays": len(structure.ray_image),
    }
    return ", ".join(f"{what} {count}" for what, count in counts.items())


def _observations(figures: Figures) -> list[str]:
    """The groups of observations: number, root mean square of v / sigma, largest one."""
    of_control = figures.control_point[figures.structure.ray_point]
    rays = figures.normalised[0]
    parts = [
        ("image coordinates of control points", rays[of_control].ravel()),
        ("image coordinates of tie points", rays[~of_control].ravel()),
        *((other.title, other.normalised[np.isfinite(other.residuals)]) for other in figures.tables),
    ]
    rows = [
        (name, str(v.size), f"{np.sqrt(np.mean(v**2)):.4g}", f"{np.abs(v).max():.4g}") for name, v in parts if v.size
    ]
    return aligned([("group", "number", "rms v/sigma", "largest"), *rows])


def _images(figures: Figures) -> list[str]:
    structure = figures.structure
    units = [structure.object_unit] * 3 + [structure.angle_unit] * 3
    places = [decimals(column) for column in figures.exterior_sd.T]
    rows = []
    for i, name in enumerate(structure.image_names[:IMAGES]):
        values = [fixed(v, p) for v, p in zip(figures.exterior[i], places, strict=True)]
        deviations = [deviation(s, p) for s, p in zip(figures.exterior_sd[i], places, strict=True)]
        rows += [(short(name), str(figures.rays_of_image[i]), *values), ("", "", *deviations)]
    header = ["image", "rays", *(with_unit(e, u) for e, u in zip(structure.exterior_elements, units, strict=True))]
    count = len(structure.image_names)
    lines = aligned([header, *rows])
    return lines if count <= IMAGES else [*lines, f"  ... the first {IMAGES} of {count} images; the tables hold all"]


def _inner_orientations(figures: Figures) -> list[str]:
    """A line an image: sigma0 of its fit and its worst fiducial."""
    fits = figures.structure.inner_orientations
    rows = []
    for fit in fits[:IMAGES]:
        (vx, vy), sigma0 = fit.residuals[fit.worst], fixed(fit.sigma0, 5)
        worst = short(fit.fiducials[fit.worst]), fixed(vx, 5), fixed(vy, 5)
        rows.append(
            (short(fit.image), fit.transformation, *map(str, (len(fit.fiducials), fit.redundancy)), sigma0, *worst)
        )
    header = ("image", "transformation", "fiducials", "redundancy", "sigma0", "worst", "vx", "vy")
    return table(header, rows, len(fits), "images", left=2) if fits else []


def _cameras(figures: Figures) -> list[str]:
    structure = figures.structure
    estimated = np.flatnonzero(structure.interior_free.any(1))
    rows = []
    for c in estimated[:CAMERAS]:
        camera = structure.cameras[c]
        for k in np.flatnonzero(structure.interior_free[c]):
            value, sd = figures.interior[c, k], figures.interior_sd[c, k]
            ratio = f"{abs(value) / sd:.1f}" if sd > 0 else "-"
            deviation = f"{sd:.3g}" if np.isfinite(sd) else "-"
            element = camera.model.elements[k]
            rows.append((short(camera.name), element, f"{value:.8g}", deviation, camera.unit_of(element), ratio))
    if not rows:
        return ["  none: all interior elements are held"]
    lines = aligned([("camera", "element", "value", "sd", "unit", "|value|/sd"), *rows], left=2)
    more = len(estimated) - CAMERAS
    return (
        lines if more <= 0 else [*lines, f"  ... the first {CAMERAS} of {len(estimated)} cameras; the tables hold all"]
    )


def _parameters(figures: Figures) -> list[str]:
    """Those that are unknown, and those held at a value."""
    structure, t = figures.structure, figures.significance.tolist()
    shown = np.flatnonzero(structure.parameter_free | (figures.parameters != 0))
    rows = []
    for k in shown[:POINTS]:
        parameter, value, sd = structure.parameters[k], figures.parameters[k], figures.parameters_sd[k]
        deviation = "held" if not parameter.free else f"{sd:.3g}" if np.isfinite(sd) else "-"
        rows.append((short(parameter.name, PARAMETER), f"{value:.8g}", deviation, parameter.unit, fixed(t[k], 1)))
    header = ("parameter", "value", "sd", "unit", "|value|/sd")
    return table(header, rows, len(shown), "parameters") if rows else []


def _points(figures: Figures) -> list[str]:
    structure, unknown = figures.structure, figures.unknown_points
    places = [decimals(column[unknown]) for column in figures.points_sd.T]
    rows = []
    for p in unknown[:POINTS]:
        values = [fixed(v, d) for v, d in zip(figures.points[p], places, strict=True)]
        deviations = [deviation(s, d) for s, d in zip(figures.points_sd[p], places, strict=True)]
        rows.append((short(structure.point_names[p]), str(figures.rays_of_point[p]), *values, *deviations))
    if not rows:
        return ["  all coordinates of all points are fixed"]
    unit = structure.object_unit
    header = ("point", "rays", *(with_unit(c, unit) for c in "XYZ"), *(with_unit(f"sd {c}", unit) for c in "XYZ"))
    return [*_summary_of_points(figures), *table(header, rows, len(unknown), "points")]


def _summary_of_points(figures: Figures) -> list[str]:
    """Mean and largest standard deviations: what a reader of many points looks for."""
    sd, free = figures.points_sd, figures.structure.point_free
    if not np.isfinite(sd).all():
        return []
    rms = [np.sqrt(np.mean(column[f] ** 2)) if f.any() else 0.0 for column, f in zip(sd.T, free.T, strict=True)]
    rows = [("sd, root mean square", *(f"{s:.3g}" for s in rms)), ("sd, largest", *(f"{s:.3g}" for s in sd.max(0)))]
    header = ("", *(with_unit(c, figures.structure.object_unit) for c in "XYZ"))
    return [*aligned([header, *rows]), ""]


def _control(figures: Figures) -> list[tuple[str, list[str]]]:
    """Control coordinates that are fixed, and residuals of those that are observed."""
    structure = figures.structure
    points = np.flatnonzero(~structure.point_free.all(1))
    held = [_held(structure.point_names[p], structure.point_free[p]) for p in points[:POINTS]]
    more = f" and {len(points) - POINTS} more" if len(points) > POINTS else ""
    lines = wrapped("Fixed:", ", ".join(held) + more, 10) if held else []
    for observed in figures.tables:
        lines += _group(figures, observed) if observed.name == CONTROL.name else []
    return [(with_unit("Control points: adjusted less observed", structure.object_unit), lines)]


def _held(name: str, free: np.ndarray) -> str:
    """A point with coordinates that are fixed, which are named unless all are."""
    return f"{name} ({', '.join(np.array(list('XYZ'))[~free])})" if free.any() else name


def _title(observed: GroupTable) -> str:
    unit = f" [{observed.units[0]}]" if observed.units[0] else ""
    return f"{observed.title.capitalize()}: computed less observed{unit}"


def _group(figures: Figures, observed: GroupTable) -> list[str]:
    """Residuals of a kind of observation, their standard deviations a priori and the largest |w| / sigma0."""
    residuals, sigmas, components = observed.residuals, observed.sigmas, observed.components
    places = decimals(sigmas) + 1
    names = {key: column for key, column in observed.who.items() if key != "parameters" or len(components) < 3}
    of_parameter = PARAMETER if len(names) == 1 else OWNER
    longest = [of_parameter if key == "parameter" else NAME for key in names]
    scale = figures.sigma0 if figures.sigma0 > 0 else np.inf
    sizes, size_name = (
        (observed.normalised, "|v|/(sigma0 sigma)") if np.isnan(observed.w).all() else (observed.w, "|w|/sigma0")
    )
    rows = []
    for m in range(min(len(residuals), POINTS)):
        cells = [(fixed(residuals[m, c], places), f"{sigmas[m, c]:.3g}") for c in range(len(components))]
        cells = [cell if np.isfinite(v) else ("-", "-") for cell, v in zip(cells, residuals[m], strict=True)]
        size = np.nanmax(np.abs(sizes[m]), initial=0.0) / scale
        who = [short(column[m], most) for column, most in zip(names.values(), longest, strict=True)]
        rows.append((*who, *(v for v, _ in cells), *(s for _, s in cells), f"{size:.2f}"))
    header = (*names, *(f"v {c}" for c in components), *(f"sigma {c}" for c in components), size_name)
    return table(header, rows, len(residuals), observed.title, left=len(names))


def _check_points(figures: Figures) -> list[str]:
    structure, differences = figures.structure, figures.check_differences
    if not len(structure.check_point):
        return []
    sd = figures.points_sd[structure.check_point]
    places = [decimals(column) for column in sd.T]
    rows = [
        (
            short(structure.point_names[p]),
            *(fixed(v, d) for v, d in zip(figures.points[p], places, strict=True)),
            *(fixed(v, d) for v, d in zip(differences[c], places, strict=True)),
            *(deviation(v, d) for v, d in zip(sd[c], places, strict=True)),
        )
        for c, p in enumerate(structure.check_point[:POINTS])
    ]
    unit = structure.object_unit
    header = ("point", *(with_unit(f"{what}{c}", unit) for what in ("", "d", "sd ") for c in "XYZ"))
    known = np.isfinite(differences)
    squares = np.where(known, differences, 0.0) ** 2
    rms = np.sqrt(squares.sum(0) / np.maximum(known.sum(0), 1))
    return [
        *table(header, rows, len(structure.check_point), "check points"),
        f"  root mean square  dX {rms[0]:.3g}  dY {rms[1]:.3g}  dZ {rms[2]:.3g}  {unit}".rstrip(),
    ]


def _down_weighted(figures: Figures) -> list[str]:
    structure, rays, weights, v = figures.structure, figures.down_weighted, figures.weights, figures.residuals[0]
    if weights is None:
        return []
    rows = [
        (
            short(structure.image_names[structure.ray_image[ray]]),
            short(structure.point_names[structure.ray_point[ray]]),
            *(f"{component:.4g}" for component in v[ray]),
            structure.cameras[structure.image_camera[structure.ray_image[ray]]].image_unit,
            f"{weights[ray]:.3f}",
        )
        for ray in rays[:POINTS]
    ]
    return table(("image", "point", "vx", "vy", "", "weight"), rows, len(rays), "rays", left=2) if rows else ["  none"]


def _worst_rays(figures: Figures) -> list[str]:
    structure, size, v = figures.structure, figures.ray_size, figures.residuals[0]
    count = min(WORST, len(size))
    worst = np.argpartition(-size, count - 1)[:count] if count else np.zeros(0, int)
    rows = []
    for ray in worst[np.argsort(-size[worst], kind="stable")]:
        image = structure.ray_image[ray]
        unit = structure.cameras[structure.image_camera[image]].image_unit
        names = short(structure.image_names[image]), short(structure.point_names[structure.ray_point[ray]])
        rows.append((*names, f"{v[ray, 0]:.4g}", f"{v[ray, 1]:.4g}", unit, f"{size[ray]:.2f}"))
    return aligned([("image", "point", "vx", "vy", "", _size_of_rays(figures)), *rows], left=2)


def _size_of_rays(figures: Figures) -> str:
    """What residuals of rays are compared by."""
    return "|v|/(sigma0 sigma)" if figures.adjustment.redundancy_numbers is None else "|w|/sigma0"


def _correlations(figures: Figures) -> list[str]:
    high = [pair for pair in figures.correlations() if abs(pair[3]) > HIGH_CORRELATION]
    pairs = [(short(figures.structure.cameras[c].name), a, b, r) for c, a, b, r in high]
    pairs += [
        ("", short(a, PARAMETER), short(b, PARAMETER), r) for a, b, r in correlated_parameters(figures.adjustment)
    ]
    rows = [(camera, a, b, f"{r:.4f}") for camera, a, b, r in pairs[:CAMERAS]]
    return table(("camera", "", "", "correlation"), rows, len(pairs), "pairs", left=3) if rows else []
