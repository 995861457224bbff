"""Functions of the commands of `jaxbundle plan`; each returns its exit code."""

from pathlib import Path

import numpy as np
import typer

from jaxbundle.block.block import Block
from jaxbundle.block.wording import counted
from jaxbundle.cli.codes import BadInput, Code
from jaxbundle.io import read, write_block_folder
from jaxbundle.io.flight_toml import read_flight
from jaxbundle.io.tables import write_table
from jaxbundle.planning.accuracy import Specification, check_specification, control_of, in_area, mean_variance
from jaxbundle.planning.control_candidates import Candidates, candidates_of
from jaxbundle.planning.control_search import Layout, Objective, best_layout
from jaxbundle.planning.design_derivatives import derivatives_of
from jaxbundle.planning.monte_carlo_runs import monte_carlo as scatter_of
from jaxbundle.planning.prediction import predict
from jaxbundle.planning.sensitivities import Effect, Sensitivity, sensitivity
from jaxbundle.planning.simulation import simulate_flight
from jaxbundle.report.planned import write_plan
from jaxbundle.report.sigma_map import Map, sigma_map
from jaxbundle.report.text import aligned
from jaxbundle.textbook import accuracy_laws

Three = tuple[float, float, float]


def flight(path: Path, out: Path) -> int:
    """Predicts, writes and prints."""
    plan, specification = read_flight(path)
    truth = simulate_flight(plan).truth
    prediction = predict(truth)
    typer.echo("\n".join(write_plan(prediction, plan, specification, out)))
    typer.echo(f"Results: {out}")
    kept = specification is None or check_specification(prediction, specification, in_area(truth, plan)).passed
    return Code.ADJUSTED if kept and not prediction.undetermined else Code.NOT_TRUSTED


def simulate(path: Path, out: Path) -> int:
    """Writes the block, the truth and the rays with gross errors."""
    block, truth, gross = simulate_flight(read_flight(path).plan)
    write_block_folder(block, out / "block")
    write_block_folder(truth, out / "truth")
    s = block.structure
    if len(gross):
        errors = np.asarray(block.rays.coordinates - truth.rays.coordinates)[gross]
        names = {
            "image": [s.image_names[k] for k in s.ray_image[gross]],
            "point": [s.point_names[k] for k in s.ray_point[gross]],
        }
        write_table(out / "gross_errors.csv", {**names, "dx": errors[:, 0], "dy": errors[:, 1]})
    typer.echo(f"{block!r}\nBlock: {out / 'block'}, truth: {out / 'truth'}")
    return Code.ADJUSTED


def control(path: Path, count: int | None, wanted: tuple[Three, str, str, int], out: Path) -> int:
    """Searches positions for control points, predicts with them, writes and prints."""
    plan, specification = read_flight(path)
    sigmas, kind, criterion, places = wanted
    if count is None and specification is None:
        raise BadInput("give --points, or a [specification] in the flight, for the minimum number of points")
    truth = simulate_flight(plan).truth
    judged = np.flatnonzero(in_area(truth, plan))
    candidates = candidates_of(
        truth, spread_candidates(truth, in_area(truth, plan), places), sigmas, kind, judged=judged
    )
    weights = (1.0, 1.0, 1.0)
    if specification is not None:
        weights = (specification.xy**-2, specification.xy**-2, specification.z**-2)
    objective = Objective(criterion, weights)
    if count is not None:
        layout, kept = best_layout(candidates, count, objective), None
    else:
        assert specification is not None
        layout, kept = _fewest(candidates, specification, objective)
    for line in _layout_lines(truth, layout, kept):
        typer.echo(line)
    out.mkdir(parents=True, exist_ok=True)
    s, xyz = truth.structure, np.asarray(truth.object_points)
    names = [s.point_names[k] for k in layout.points]
    columns = dict(zip(("X", "Y", "Z"), xyz[layout.points].T, strict=True))
    write_table(out / "control.csv", {"point": names, **columns})
    deviations = np.full(len(xyz), np.nan)
    deviations[candidates.judged] = np.sqrt(layout.variances.mean(1))
    chosen = control_of(truth)
    chosen[layout.points] = True
    stations = np.asarray(truth.exterior.projection_centre)[:, :2]
    title = f"{s.name}: {len(names)} new control points; root of the mean variance of X, Y, Z"
    shown = Map(title, s.object_unit, xyz[:, :2], deviations, chosen, stations, s.point_names)
    (out / "control.svg").write_text(sigma_map(shown), encoding="utf-8")
    typer.echo(f"Results: {out}")
    return Code.NOT_TRUSTED if kept is False else Code.ADJUSTED


def spread_candidates(block: Block, points: np.ndarray, count: int) -> np.ndarray:
    """Points spread over the block: each next point is the farthest from those before it."""
    free = np.flatnonzero(points)
    xy = np.asarray(block.object_points)[free, :2]
    chosen = [int(np.argmin(xy.sum(1)))]
    distance = np.linalg.norm(xy - xy[chosen[0]], axis=1)
    while len(chosen) < min(count, len(free)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(xy - xy[chosen[-1]], axis=1))
    return free[np.sort(chosen)]


def _fewest(candidates: Candidates, specification: Specification, objective: Objective) -> tuple[Layout, bool]:
    """The minimum number of points whose best layout meets the specification."""
    limits = np.array([specification.xy, specification.xy, specification.z])
    layout = None
    for count in range(1, min(40, len(candidates.points)) + 1):
        layout = best_layout(candidates, count, objective, bound=False)
        if np.mean((np.sqrt(layout.variances) <= limits).all(1)) >= specification.share:
            return best_layout(candidates, count, objective), True
    assert layout is not None
    return layout, False


def _layout_lines(block: Block, layout: Layout, kept: bool | None) -> list[str]:
    s, xyz = block.structure, np.asarray(block.object_points)
    rows = [("point", "X", "Y", "Z")]
    rows += [(s.point_names[k], *(f"{x:.2f}" for x in xyz[k])) for k in layout.points]
    rms = " ".join(f"{x:.4g}" for x in np.sqrt(layout.variances.mean(0)))
    largest = " ".join(f"{x:.4g}" for x in np.sqrt(layout.variances.max(0)))
    lines = [counted(len(layout.points), "control point"), *aligned(rows)]
    lines.append(f"standard deviations of all points, X Y Z: rms {rms}, maximum {largest} {s.object_unit}")
    if np.isfinite(layout.bound):
        better = 1 - np.sqrt(layout.bound / layout.objective)
        lines.append(
            f"no layout with this number of positions is better by more than {better:.0%} of the root mean variance"
        )
    if kept is not None:
        lines.append("the specification is met" if kept else "no number of points up to this meets the specification")
    return lines


def monte_carlo(path: Path, draws: int, seed: int) -> int:
    """Adjusts many times and prints the test."""
    found = scatter_of(simulate_flight(read_flight(path).plan).truth, draws, seed)
    single = found.ratios[np.isfinite(found.ratios)]
    typer.echo(f"{found.converged} of {found.draws} adjustments converged, sigma0 {found.sigma0:.4f}")
    typer.echo(f"scatter^2 / predicted variance: mean {found.mean:.4f}, its standard deviation {found.mean_sigma:.4f}")
    low, high = found.limits
    typer.echo(
        f"single coordinates {single.min():.3f} to {single.max():.3f}; outside {low:.3f} to {high:.3f}"
        f" (0.1 % by chance): {found.share_outside:.2%} of {len(single)}"
    )
    typer.echo("the scatter agrees with the prediction" if found.passed else "the scatter contradicts the prediction")
    return Code.ADJUSTED if found.passed else Code.NOT_TRUSTED


def design(path: Path) -> int:
    """Prints the derivatives of the mean variance, as changes of the root mean variance."""
    plan, _ = read_flight(path)
    truth = simulate_flight(plan).truth
    found = derivatives_of(truth, plan, mean_variance(points=in_area(truth, plan)))
    root, unit = found.value**0.5, truth.structure.object_unit
    typer.echo(f"root of the mean variance of the points without control: {root:.4g} {unit}")

    def change(derivative: float, step: float) -> str:
        return f"{derivative * step / (2 * root) / root:+.2%}"

    rows = [("changed by", "root mean variance")]
    rows.append(("image sigma + 10 %", change(found.image_sigma, 0.1)))
    if plan.gnss or plan.ins:
        rows.append(("sigmas of the navigation + 10 %", change(found.navigation_sigma, 0.1)))
    rows.append(("forward overlap + 1 %", change(found.forward_overlap, 0.01)))
    rows.append(("side overlap + 1 %", change(found.side_overlap, 0.01)))
    rows.append(("flying height + 1 %", change(found.height, 0.01 * plan.height)))
    base = (1 - plan.forward_overlap) * plan.height / plan.camera.principal_distance * plan.camera.width
    for k, position, sigma in zip(found.control, found.control_positions, found.control_sigmas, strict=True):
        name, step = truth.structure.point_names[k], base / 10
        moves = " ".join(change(d, step) for d in position[:2])
        rows.append((f"control {name} shifted by {step:.1f} {unit} in X, in Y", moves))
        if sigma.any():
            known = sum(float(d) for d in sigma)
            rows.append((f"sigma of control {name} + 1 mm", change(known, 0.001)))
    typer.echo("\n".join(aligned(rows)))
    return Code.ADJUSTED


def sensitivity_of(path: Path, point: str, coordinate: str, rows: int, out: Path | None) -> int:
    """Prints the observations and values with the largest effect on a coordinate."""
    block = read(path)
    names = block.structure.point_names
    if point not in names:
        raise BadInput(f"point {point} is not in the block, which has {names[0]} to {names[-1]}")
    index, axis = names.index(point), "XYZ".index(coordinate)
    found = sensitivity(block, lambda b: b.object_points[index, axis])
    unit = block.structure.object_unit
    typer.echo(
        f"{coordinate} of point {point}: {found.value:.4f} {unit}, a priori sd {found.standard_deviation:.4g} {unit}"
    )
    table = [("observation", "derivative", f"effect of an error of one sigma [{unit}]")]
    table += [(_who(e), f"{e.derivative:+.4g}", f"{e.effect:+.4g}") for e in found.effects[:rows]]
    typer.echo("\n".join(aligned(table)))
    if found.held:
        typer.echo(f"known values, and the effect on {coordinate} of 0.001 of their unit [{unit}]")
        table = [(f"{_who(e)} [{e.unit}]", f"{e.derivative * 0.001:+.4g}") for e in found.held[:rows]]
        typer.echo("\n".join(aligned(table)))
    if out is not None:
        out.with_suffix(".svg").write_text(_effect_map(block, found, point, coordinate), encoding="utf-8")
        every = [*found.effects, *found.held]
        write_table(
            out,
            {
                "value": [_who(e) for e in every],
                "derivative": np.array([e.derivative for e in every]),
                "sigma": np.array([e.sigma for e in every]),
                "effect": np.array([e.effect for e in every]),
            },
        )
    return Code.ADJUSTED


def _effect_map(block: Block, found: Sensitivity, point: str, coordinate: str) -> str:
    """A map of the effect of rays and control of each point on a coordinate, for errors of one sigma."""
    s = block.structure
    place, squares = {name: k for k, name in enumerate(s.point_names)}, np.zeros(len(s.point_names))
    for effect in found.effects:
        if effect.subject.table in ("rays", "control"):
            squares[place[effect.subject.names[-1]]] += effect.effect**2
    title = (
        f"{s.name}: effect of the observations of each point on {coordinate} of point {point}, for errors of one sigma"
    )
    xy, stations = np.asarray(block.object_points)[:, :2], np.asarray(block.exterior.projection_centre)[:, :2]
    unjudged = np.zeros(len(squares), bool)  # control points are coloured as well
    return sigma_map(Map(title, s.object_unit, xy, np.sqrt(squares), unjudged, stations, s.point_names))


def _who(effect: Effect) -> str:
    table, names, component = effect.subject
    return f"{component} of {' '.join(names)} ({table})"


def laws(scale: float, parallax: float, camera: tuple[float, float], pairs: int, tolerance: Three | None) -> int:
    """Prints the laws of accumulation for a strip, and the distance between control."""
    f, base = camera
    try:
        setup = accuracy_laws.StripSetup(scale, parallax / 1000, f / 1000, base / 1000)
        rows: list[tuple[str, ...]] = [(f"{pairs} stereopairs, m", "X", "Y", "Z")]
        for name, law in (("printed", accuracy_laws.PRINTED), ("bundle", accuracy_laws.BUNDLE)):
            rows.append((f"free end, {name}", *_metres(accuracy_laws.free_end(pairs, setup, law))))
            for ends in accuracy_laws.ENDS:
                middle = accuracy_laws.tied_middle(pairs, setup, law, ends)
                rows.append((f"middle, {name}, ends {ends}", *_metres(middle)))
        spacings = []
        if tolerance is not None:
            for name, law in (("printed", accuracy_laws.PRINTED), ("bundle", accuracy_laws.BUNDLE)):
                spacings.append((name, accuracy_laws.spacing(tolerance, setup, law)))
    except ValueError as error:
        raise BadInput(str(error)) from error
    typer.echo("\n".join(aligned(rows)))
    typer.echo(
        "printed: the parallax error is that of a parallax; bundle: read as the sigma of one image coordinate, 60 %"
        " overlap.\nhinged ends fix positions (one point); clamped ends also fix scale and azimuth (two XYZ points"
        " across)."
    )
    exact, printed = accuracy_laws.accumulation(pairs), accuracy_laws.printed_accumulation(pairs)
    typer.echo(
        f"growth of a sum of errors: exact {exact:.2f}, printed 0.58 n^1.5 {printed:.2f} ({printed / exact - 1:+.1%})"
    )
    for name, found in spacings:
        low, high = (found.distance * factor / 1000 for factor in accuracy_laws.BLOCK_FACTORS)
        typer.echo(
            f"{name}: control every {found.pairs} stereopairs, {found.distance / 1000:.2f} km; in a block, by the"
            f" printed factor 1.5 to 2, {low:.2f} to {high:.2f} km;"
            f" predicted X Y Z {' '.join(_metres(found.predicted))} m"
        )
    return Code.ADJUSTED


def _metres(values: np.ndarray) -> tuple[str, ...]:
    return tuple(f"{x:.3f}" for x in values)
