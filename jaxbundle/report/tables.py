"""The report as a table of tables: numbers, names, lists and None, ready for JSON.

A value stands as [value, standard deviation]: a posteriori, object unit and angle unit of the block; 0 = held,
None = not known.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxbundle.block.block import Structure
from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a
from jaxbundle.diagnosis.elements import correlated_parameters
from jaxbundle.diagnosis.sigmas import global_test
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.reliability_table import reliability_of_groups
from jaxbundle.solve.adjustment import Adjustment


def report_dict(adjustment: Adjustment) -> dict[str, Any]:
    """The report of a concrete adjustment: counts, sigma0, all unknowns with their standard deviations."""
    require_a(Adjustment, adjustment, "report_dict")
    return dict_of(figures_of(adjustment))


def dict_of(figures: Figures) -> dict[str, Any]:
    """`report_dict` from numbers that are converted already."""
    adjustment, structure = figures.adjustment, figures.structure
    test = global_test(figures.sigma0, adjustment.redundancy)
    unknown, check = figures.unknown_points, structure.check_point
    report = {
        "kind": "block",
        "name": structure.name,
        "units": {"object": structure.object_unit, "angle": structure.angle_unit},
        "status": adjustment.status.name.lower().replace("_", " "),
        "trustworthy": adjustment.trustworthy,
        "findings": [_finding(finding) for finding in figures.findings],
        "observations": adjustment.observations,
        "unknowns": adjustment.unknowns,
        "redundancy": adjustment.redundancy,
        "sigma0": figures.sigma0,
        "sigma0_limits": [test.lower, test.upper],
        "vtPv": figures.vtpv,
        "vtPv_at_start": 2 * float(adjustment.iterations.initial_cost),
        "method": adjustment.method,
        "iterations": int(adjustment.iterations.trials),
        "stopping_rule": adjustment.stopping_rule,
        "measure": float(adjustment.iterations.measure),
        "datum": str(structure.datum),
        "constraints": inner_constraints(structure),
        **_robust(figures),
        "cameras": _cameras(figures),
        "parameters": _parameters(figures),
        "check_points": _check_points(figures, [structure.point_names[p] for p in check]),
        **_inner_orientations(figures),
        "correlations": _correlations(figures),
        "reliability": reliability_of_groups(figures),
        "high_parameter_correlations": correlated_parameters(adjustment),
    }
    names = [structure.point_names[p] for p in unknown]
    return finite(report) | {
        "images": _entries(structure.image_names, structure.exterior_elements, figures.exterior, figures.exterior_sd),
        "points": _entries(names, "XYZ", figures.points[unknown], figures.points_sd[unknown]),
    }


def _finding(finding: Finding) -> dict[str, Any]:
    """A finding for other programs: they need not read its sentences."""
    return {
        "severity": finding.severity.label,
        "kind": finding.kind.title,
        "what": finding.what,
        "cure": finding.cure,
        "subjects": [{"table": s.table, "names": list(s.names), "component": s.component} for s in finding.subjects],
        "size": finding.size,
        "unit": finding.unit,
    }


def inner_constraints(structure: Structure) -> int:
    """Constraints that count in the redundancy: those of a free network whose elements are all unknown."""
    return 0 if structure.datum.held else structure.datum.constraints


def finite(value: Any) -> Any:
    """The same as JSON can hold it: tables by name, lists, names and numbers; None in place of what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        plain, known = value.astype(object), np.isfinite(value)
        plain[~known] = None
        return value.tolist() if known.all() else plain.tolist()
    if isinstance(value, np.generic):
        return finite(value.item())
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _entries(
    names: Iterable[str], elements: Sequence[str], values: np.ndarray, deviations: np.ndarray
) -> dict[str, dict[str, list]]:
    """name: {element: [value, sd]}."""
    pairs = finite(np.stack([values, deviations], -1))
    return {name: dict(zip(elements, row, strict=True)) for name, row in zip(names, pairs, strict=True)}


def _cameras(figures: Figures) -> dict[str, dict[str, list]]:
    free = figures.structure.interior_free
    cameras = {}
    for c in np.flatnonzero(free.any(1)):
        camera, columns = figures.structure.cameras[c], np.flatnonzero(free[c])
        pairs = np.stack([figures.interior[c, columns], figures.interior_sd[c, columns]], -1)
        cameras[camera.name] = {camera.model.elements[k]: pair for k, pair in zip(columns, pairs, strict=True)}
    return cameras


def _parameters(figures: Figures) -> dict[str, dict[str, Any]]:
    pairs = np.stack([figures.parameters, figures.parameters_sd], -1)
    return {
        parameter.name: {"value": pair, "unit": parameter.unit, "t": float(t)}
        for parameter, pair, t in zip(figures.structure.parameters, pairs, figures.significance, strict=True)
    }


def _robust(figures: Figures) -> dict[str, Any]:
    """The weight function and the rays that lost more than half of their weight: image, point, weight."""
    robust, weights, structure = figures.adjustment.reweighting, figures.weights, figures.structure
    if robust is None or weights is None:
        return {}
    images, points = structure.image_names, structure.point_names
    rays = [
        [images[structure.ray_image[ray]], points[structure.ray_point[ray]], float(weights[ray])]
        for ray in figures.down_weighted
    ]
    return {"robust": {"function": robust.name, "limit": robust.limit, "rounds": robust.rounds, "down_weighted": rays}}


def _check_points(figures: Figures, names: list[str]) -> dict[str, dict[str, Any]]:
    check = figures.structure.check_point
    entries = _entries(names, "XYZ", figures.points[check], figures.points_sd[check])
    differences = figures.check_differences
    return {
        name: {**entry, **dict(zip(("dX", "dY", "dZ"), row, strict=True))}
        for (name, entry), row in zip(entries.items(), differences, strict=True)
    }


def _inner_orientations(figures: Figures) -> dict[str, dict[str, dict[str, Any]]]:
    """Fits of scanned images to their fiducials, where there are any; mm."""
    fits = {
        fit.image: {
            "transformation": fit.transformation,
            **fit.parameters,
            "redundancy": fit.redundancy,
            "sigma0": fit.sigma0,
            "fiducials": dict(zip(fit.fiducials, fit.residuals.tolist(), strict=True)),
        }
        for fit in figures.structure.inner_orientations
    }
    return {"inner_orientations": fits} if fits else {}


def _correlations(figures: Figures) -> dict[str, dict[str, float | None]]:
    cameras: dict[str, dict[str, float | None]] = {}
    for c, a, b, r in figures.correlations():
        cameras.setdefault(figures.structure.cameras[c].name, {})[f"{a},{b}"] = r
    return cameras
