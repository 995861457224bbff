"""The report of a planned block: text, tables and maps of its predicted precision."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.wording import counted
from jaxbundle.io.tables import write_table
from jaxbundle.planning.accuracy import Specification, check_specification, control_of, in_area, summary_of
from jaxbundle.planning.flight import FlightPlan
from jaxbundle.planning.prediction import Prediction
from jaxbundle.report.sigma_map import Map, sigma_map
from jaxbundle.report.text import aligned
from jaxbundle.statistics.reliability_tables import UNCONTROLLED

# correlation of two interior elements: above this they cannot be separated, and their errors bend the block
CORRELATED = 0.9
ANGLES = 180 / np.pi


def write_plan(
    prediction: Prediction, plan: FlightPlan, specification: Specification | None, folder: str | Path
) -> list[str]:
    """Writes prediction.txt, prediction.json, points.csv, images.csv and maps; returns the lines of the text."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    lines = plan_lines(prediction, plan, specification)
    _write(place / "prediction.txt", "\n".join(lines) + "\n")
    _write(place / "prediction.json", json.dumps(plan_dict(prediction, plan, specification), indent=1) + "\n")
    s, block = prediction.block.structure, prediction.block
    sd = prediction.standard_deviations
    points, control = np.asarray(sd.object_points), control_of(block)
    rays = np.bincount(s.ray_point, minlength=len(s.point_names))
    write_table(
        place / "points.csv",
        {
            "point": list(s.point_names),
            **_columns(("X", "Y", "Z"), np.asarray(block.object_points)),
            **_columns(("sX", "sY", "sZ"), points),
            "rays": rays,
            "control": ["yes" if c else "" for c in control],
        },
    )
    write_table(
        place / "images.csv",
        {
            "image": list(s.image_names),
            **_columns(("X0", "Y0", "Z0"), np.asarray(block.exterior.projection_centre)),
            **_columns(("sX0", "sY0", "sZ0"), np.asarray(sd.projection_centre)),
            **_columns([f"s{angle}" for angle in s.rotation_system.angles], ANGLES * np.asarray(sd.angles)),
        },
    )
    xy, stations = np.asarray(block.object_points)[:, :2], np.asarray(block.exterior.projection_centre)[:, :2]
    for name, sigmas in (("XY", np.sqrt((points[:, :2] ** 2).mean(1))), ("Z", points[:, 2])):
        title = f"{s.name}: predicted standard deviation of {name} (triangles: control, ring: worst point)"
        shown = Map(title, s.object_unit, xy, sigmas, control, stations, s.point_names)
        _write(place / f"sigma_{name}.svg", sigma_map(shown))
    return lines


def plan_lines(prediction: Prediction, plan: FlightPlan, specification: Specification | None) -> list[str]:
    """The report as text."""
    block, s = prediction.block, prediction.block.structure
    lines = [f"Predicted accuracy of {s.name}", "", *_verdict(prediction, plan, specification)]
    lines += ["", *_flight(block, plan)]
    if prediction.undetermined:
        return [*lines, "", "  Standard deviations are available only after this problem is solved."]
    lines += ["", *_deviations(prediction, plan)]
    lines += ["", "Reliability (level 0.1 %, power 80 %)", *_reliability(prediction)]
    interior = _interior(prediction)
    return [*lines, *(["", "Interior elements", *interior] if interior else [])]


def _deviations(prediction: Prediction, plan: FlightPlan) -> list[str]:
    numbers = summary_of(prediction, in_area(prediction.block, plan))
    where = "of the area that are not control" if plan.area else "that are not control"
    unit = plan.sigma * plan.scale_number
    rows = [("", "X", "Y", "Z")]
    rows += [
        (name, *(f"{x:.4g}" for x in values))
        for name, values in (("rms", numbers.rms), ("median", numbers.median), ("maximum", numbers.maximum))
    ]
    rows.append(("worst point", *numbers.worst))
    rows.append(("rms in sigma0 m", *(f"{x / unit:.2f}" for x in numbers.rms)))
    count = counted(numbers.judged, "point")
    return [f"Standard deviations of {count} {where}, {prediction.block.structure.object_unit}", *aligned(rows)]


def _verdict(prediction: Prediction, plan: FlightPlan, specification: Specification | None) -> list[str]:
    found = [f"  Failed: {finding.words}" for finding in prediction.undetermined]
    if specification is None:
        return found or ["  All unknowns are determined."]
    check, unit = (
        check_specification(prediction, specification, in_area(prediction.block, plan)),
        prediction.block.structure.object_unit,
    )
    told = "meets" if check.passed and not found else "does not meet"
    limits = (
        f"X, Y {specification.xy:g} {unit}, Z {specification.z:g} {unit} at {specification.share:.0%} of the points"
    )
    shares = f"X, Y at {check.share_xy:.1%}, Z at {check.share_z:.1%}, both at {check.share:.1%}"
    return [*found, f"  The flight {told} the specification {limits}: {shares}."]


def _flight(block: Block, plan: FlightPlan) -> list[str]:
    s = block.structure
    counts = [counted(len(s.image_names), "image"), counted(len(s.point_names), "point")]
    counts += [counted(len(s.ray_image), "ray"), counted(int(control_of(block).sum()), "control point")]
    counts += [counted(len(s.check_point), "check point")]
    unit = "px" if plan.camera.pixel_size else "mm"
    return [
        f"  {', '.join(counts)}",
        f"  height {plan.height:.1f} m, scale 1:{plan.height / plan.camera.principal_distance * 1000:.0f},"
        f" overlaps {plan.forward_overlap:.0%} and {plan.side_overlap:.0%}",
        f"  sigma of image coordinates {plan.sigma:g} {unit}, on the ground {plan.sigma * plan.scale_number:.4g} m",
    ]


def _reliability(prediction: Prediction) -> list[str]:
    found, s = prediction.reliability(), prediction.block.structure
    names = ["rays", *(group.structure.kind.table for group in prediction.block.groups)]
    rows = [("", "number", "mean r", "smallest r", f"r < {UNCONTROLLED}", "median MDE", "maximum MDE")]
    for name, r, mde in zip(names, found.redundancy_numbers, found.minimal_detectable, strict=True):
        known = np.isfinite(r)
        if not known.any():
            continue
        r, mde = r[known], mde[known]
        finite = mde[np.isfinite(mde)]
        largest = "none" if len(finite) < len(mde) else f"{finite.max():.3g}"
        middle = f"{np.median(finite):.3g}" if len(finite) else "none"
        low = str(int((r < UNCONTROLLED).sum()))
        rows.append((name, str(len(r)), f"{r.mean():.2f}", f"{r.min():.3f}", low, middle, largest))
    unit = s.cameras[0].image_unit
    return [*aligned(rows), f"  MDE: minimum detectable error; of rays in {unit}, of control in {s.object_unit}"]


def _interior(prediction: Prediction) -> list[str]:
    """Standard deviations of the interior elements, and pairs that cannot be separated."""
    s = prediction.block.structure
    sd, correlations = np.asarray(prediction.standard_deviations.interior), np.asarray(prediction.interior_correlations)
    rows, told = [("camera", "element", "sigma", "unit")], []
    for c, camera in enumerate(s.cameras):
        free = np.flatnonzero(s.interior_free[c])
        names = camera.model.elements
        rows += [(camera.name, names[k], f"{sd[c, k]:.3g}", camera.unit_of(names[k])) for k in free]
        for a, i in enumerate(free):
            for j in free[a + 1 :]:
                if abs(correlations[c, i, j]) > CORRELATED:
                    told.append(f"  {names[i]} and {names[j]} of {camera.name}: {correlations[c, i, j]:+.3f}")
    if len(rows) == 1:
        return []
    warning = (
        [f"  Correlations above {CORRELATED}; such elements bend the block where control is sparse:"] if told else []
    )
    return [*aligned(rows, 2), *warning, *told]


def plan_dict(prediction: Prediction, plan: FlightPlan, specification: Specification | None) -> dict[str, Any]:
    """The report as a dictionary for programs; lengths in object units."""
    block = prediction.block
    judged = in_area(block, plan)
    numbers = summary_of(prediction, judged)
    found: dict[str, Any] = {
        "name": block.structure.name,
        "images": len(block.structure.image_names),
        "rays": len(block.structure.ray_image),
        "control_points": int(control_of(block).sum()),
        "judged_points": int(judged.sum()),
        "ground_sigma": plan.sigma * plan.scale_number,
        **{name: [float(x) for x in getattr(numbers, name)] for name in ("rms", "median", "maximum")},
        "worst": list(numbers.worst),
        "undetermined": [finding.words for finding in prediction.undetermined],
    }
    if specification is not None:
        check = check_specification(prediction, specification, in_area(prediction.block, plan))
        found["specification"] = {**specification._asdict(), **check._asdict()}
    return found


def _columns(names: Any, values: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names, values.T, strict=True))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
