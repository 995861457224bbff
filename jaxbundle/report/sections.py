"""All sections of a report in order, and the sections of the verdict, the adjustment and the observations."""

from collections.abc import Callable
from functools import partial

import numpy as np

from jaxbundle.block.findings import Finding
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.diagnosis.elements import HIGH_CORRELATION, correlated_parameters
from jaxbundle.diagnosis.sigmas import global_test
from jaxbundle.report import unknown_sections
from jaxbundle.report.figures import Figures
from jaxbundle.report.group_tables import GroupTable
from jaxbundle.report.history_section import history
from jaxbundle.report.section import (
    NAME,
    OWNER,
    PARAMETER,
    Chapter,
    Fact,
    Facts,
    Picked,
    ReportColumn,
    ReportTable,
    Section,
    decimals,
    fact,
    first,
    fixed,
    name_column,
    numbers,
    of_page,
    short,
    with_digits,
    with_unit,
)
from jaxbundle.solve.adjustment import DOWN_WEIGHTED
from jaxbundle.statistics.reliability_tables import UNCONTROLLED
from jaxbundle.statistics.subsets import default_groups

WORST, PAIRS = 20, 50  # numbers of rays and correlations in the text
MAX_WORST = 500  # maximum number of rays with the largest residuals in any output
V = ("vx", "vy")
SMALLEST = np.finfo(float).tiny


def sections_of(figures: Figures) -> list[Callable[[], Section]]:
    """The functions that make the sections, in their order."""
    of = unknown_sections
    unknowns = of.images, of.inner_orientations, of.cameras, of.parameters, of.points
    before = verdict_section, adjustment_section, observations_section, *unknowns
    after = of.check_points, _down_weighted, _rays, reliability_section, _correlations, history
    return [*(partial(f, figures) for f in before), *group_sections(figures), *(partial(f, figures) for f in after)]


def group_sections(figures: Figures) -> list[Callable[[], Section]]:
    """Control first, then the other groups of observations."""
    others = [table for table in figures.tables if table.name != CONTROL.name]
    return [partial(_control, figures), *(partial(_group, figures, table) for table in others)]


def verdict_section(figures: Figures) -> Section:
    """Section with the verdict, then problems and suggestions."""
    adjustment = figures.adjustment
    verdict = fact(
        "",
        f"The adjustment {adjustment.verdict}.",
        status=adjustment.status.name.lower().replace("_", " "),
        trustworthy=adjustment.trustworthy,
        findings=[_entries_of(finding) for finding in figures.findings],
    )
    found = tuple(fact(finding.severity.label, finding.words) for finding in figures.findings)
    return Section("Verdict", (Facts((verdict,), 2), Facts(found, 14)), Chapter.VERDICT)


def _entries_of(finding: Finding) -> dict:
    """A finding for other programs, which do not need its sentences."""
    return {
        "severity": finding.severity.label,
        "kind": finding.kind.title,
        "what": finding.what,
        "cure": finding.cure,
        "subjects": [{"table": s.table, "names": list(s.names), "component": s.component} for s in finding.subjects],
        "size": finding.size,
        "unit": finding.unit,
    }


def adjustment_section(figures: Figures) -> Section:
    """Section with counts, sigma0 and the end of the adjustment."""
    adjustment, structure = figures.adjustment, figures.structure
    n, datum = adjustment.iterations, structure.datum
    test = global_test(figures.sigma0, adjustment.redundancy)
    free = structure.exterior_free, structure.interior_free, structure.parameter_free, structure.point_free
    exterior, interior, parameters, points = (int(mask.sum()) for mask in free)
    unknown = f"images {exterior}, cameras {interior}, "
    if not structure.model.photographs:
        unknown = f"sensors {exterior + interior}, "
    unknown += f"parameters {parameters}, " if structure.parameters else ""
    inner = 0 if datum.held else datum.constraints  # counts in the redundancy where all elements are unknown
    passed = "passed" if test.passed else "not passed"
    limits = f"{test.lower:.4f} < sigma0 < {test.upper:.4f} expected (chi-square, two-sided, 5 %)"
    start, vtpv, measure = 2 * float(n.initial_cost), figures.vtpv, float(n.measure)
    last = "below rounding" if measure == 0 else f"{measure:.1e}"
    end = f"stopping rule '{adjustment.stopping_rule}', last step {last}"
    how, trials = f"{int(n.accepted)} accepted; {adjustment.method}", int(n.trials)
    redundancy, rule = adjustment.redundancy, adjustment.stopping_rule
    m, u = adjustment.n_observations, adjustment.n_unknowns
    facts = (
        fact("Block", _counts(figures)),
        fact("Observations M", f"{m}", observations=m),
        fact("Unknowns N", f"{u} ({unknown}points {points})", unknowns=u),
        fact("Constraints C", f"{inner}" if inner else "", constraints=inner),
        fact(f"Redundancy M - N{' + C' if inner else ''}", f"{redundancy}", redundancy=redundancy),
        fact("Datum", str(datum), datum=str(datum)),
        *_robust(figures),
        fact("vTPv", f"{start:.8g} at the start, {vtpv:.8g} at the end", vtPv=vtpv, vtPv_at_start=start),
        fact("sigma0", f"{figures.sigma0:.6g} a posteriori, 1 a priori", sigma0=figures.sigma0),
        fact("Global test", f"{passed}: {limits}", sigma0_limits=[test.lower, test.upper]),
        fact("Iterations", f"{trials}, of which {how}", iterations=trials, method=adjustment.method),
        fact("End", f"{adjustment.status.words}; {end}", stopping_rule=rule, measure=measure),
    )
    return Section("Adjustment", (Facts(facts, 23),), Chapter.VERDICT)


def _robust(figures: Figures) -> list[Fact]:
    """Facts about the weight function and the rays that lost more than half of their weight: image, point, weight."""
    robust, weights, rays = figures.adjustment.reweighting, figures.weights, figures.down_weighted
    if robust is None or weights is None:
        return []
    low = f"{len(rays)} of {len(weights)} rays below {DOWN_WEIGHTED:g}"
    names = _names_of_rays(figures, rays)
    entries = [[names[0][k], names[1][k], float(weight)] for k, weight in enumerate(weights[rays])]
    robustly = {"function": robust.name, "limit": robust.limit, "rounds": robust.rounds, "down_weighted": entries}
    text = f"{robust.name}, limit {robust.limit:g}; {low} after {robust.rounds} rounds"
    return [fact("Robust weights", text, robust=robustly)]


def _counts(figures: Figures) -> str:
    structure = figures.structure
    model = structure.model
    sensors = {f"sensors ({model.name})": len(structure.image_names)}
    if model.photographs:
        sensors = {"images": len(structure.image_names), "cameras": len(structure.cameras)}
    counts = {
        **sensors,
        "object points": len(structure.point_names),
        "control points": int(figures.control_point.sum()),
        "check points": len(structure.check_point),
        "rays": len(structure.ray_image),
    }
    return ", ".join(f"{what} {count}" for what, count in counts.items())


def observations_section(figures: Figures) -> Section:
    """A table of the groups of observations: number, root mean square and maximum of v / sigma."""
    of_control = figures.control_point[figures.structure.ray_point]
    rays = figures.normalised[0]
    what = "image" if figures.structure.model.photographs else "measured"
    parts = [
        (f"{what} coordinates of control points", rays[of_control].ravel()),
        (f"{what} coordinates of tie points", rays[~of_control].ravel()),
        *((other.title, other.normalised[np.isfinite(other.residuals)]) for other in figures.tables),
    ]
    parts = [(name, v) for name, v in parts if v.size]
    columns = (
        name_column("group", [name for name, _ in parts], 100),
        of_page("number", np.array([v.size for _, v in parts])),
        of_page("rms v/sigma", np.array([np.sqrt(np.mean(v**2)) for _, v in parts]), with_digits(4)),
        of_page("max", np.array([np.abs(v).max() for _, v in parts]), with_digits(4)),
    )
    return Section("Observations", (ReportTable("groups", columns, np.arange(len(parts)), in_file=False),))


def _control(figures: Figures) -> Section:
    """Section with fixed control coordinates, and residuals of observed ones."""
    observed = [_group_table(figures, table) for table in figures.tables if table.name == CONTROL.name]
    held = unknown_sections.fixed_points(figures)
    title = with_unit("Control points: adjusted - observed", figures.structure.object_unit)
    return Section(title, (*([held] if held else []), *observed), Chapter.CONTROL)


def _group(figures: Figures, observed: GroupTable) -> Section:
    title = with_unit(f"{observed.title.capitalize()}: computed - observed", observed.units[0])
    return Section(title, (_group_table(figures, observed),))


def _group_table(figures: Figures, observed: GroupTable) -> ReportTable:
    """A table of observations of one kind, their a-priori standard deviations, residuals and reliability."""
    components, places = observed.components, decimals(observed.sigmas) + 1
    shown = [key for key in observed.who if key != "parameters" or len(components) < 3]
    no_w = np.isnan(observed.w).all()
    sizes, size_name = (observed.normalised, "|v|/(sigma0 sigma)") if no_w else (observed.w, "|w|/sigma0")
    scale = figures.sigma0 if figures.sigma0 > 0 else np.inf
    size = np.nanmax(np.abs(sizes), axis=1, initial=0.0) / scale
    names = []
    for key, values in observed.who.items():
        longest = NAME if key != "parameter" else PARAMETER if len(shown) == 1 else OWNER
        names.append(name_column(key, values, longest) if key in shown else ReportColumn(key, values))
    sigmas, residuals = ([f"{prefix} {c}" for c in components] for prefix in ("sigma", "v"))
    columns = [
        *names,
        *numbers(components, observed.values),
        *numbers([f"s{c}" for c in components], observed.sigmas, sigmas, show=with_digits(3), place=3),
        *numbers([f"v{c}" for c in components], observed.residuals, residuals, show=lambda v: fixed(v, places)),
    ]
    for prefix, values in (("r", observed.r), ("w", observed.w)):
        if not np.isnan(values).all():
            columns += numbers([f"{prefix}{c}" for c in components], values)
    columns.append(of_page(size_name, size, lambda value: f"{value:.2f}"))
    every = np.arange(len(size))
    shown = first(every, unknown_sections.POINTS, observed.title)
    return ReportTable(observed.name, tuple(columns), *shown, rows=every)


def _names_of_rays(figures: Figures, rays: np.ndarray | slice = slice(None)) -> tuple[Picked, Picked]:
    """Columns with the images and the points of rays."""
    structure = figures.structure
    image, point = structure.ray_image[rays], structure.ray_point[rays]
    return Picked(structure.image_names, image), Picked(structure.point_names, point)


def _units_of_rays(figures: Figures, rays: np.ndarray | slice = slice(None)) -> Picked:
    structure = figures.structure
    units = tuple(camera.image_unit for camera in structure.cameras)
    return Picked(units, structure.image_camera[structure.ray_image[rays]])


def _down_weighted(figures: Figures) -> Section:
    """A table of the rays that lost more than half of their weight."""
    rays, weights = figures.down_weighted, figures.weights
    if weights is None:
        return Section("", ())
    image, point = _names_of_rays(figures, rays)
    v = figures.residuals[0][rays]
    columns = (
        name_column("image", image),
        name_column("point", point),
        ReportColumn("weight", weights[rays], "weight", lambda value: f"{value:.3f}", 6),
        *numbers(V, v, V, show=with_digits(4)),
        of_page("", _units_of_rays(figures, rays)),
    )
    every = np.arange(len(rays))
    table = ReportTable("down_weighted", columns, *first(every, unknown_sections.POINTS, "rays"), rows=every)
    title = f"Rays with a robust weight below {DOWN_WEIGHTED:g}"
    return Section(title, (table,) if len(rays) else ("none", table), Chapter.RESIDUALS)


def _rays(figures: Figures) -> Section:
    """A table of all rays; the text shows those with the largest residuals."""
    size, reliability = figures.ray_size, figures.reliability
    count = min(MAX_WORST, len(size))
    worst = np.argpartition(-size, count - 1)[:count] if count else np.zeros(0, int)
    image, point = _names_of_rays(figures)
    rays, size_name = figures.adjustment.block.rays, "|w|/sigma0" if reliability else "|v|/(sigma0 sigma)"
    columns = [
        name_column("image", image),
        name_column("point", point),
        *numbers(("x", "y"), np.asarray(rays.coordinates)),
        *numbers(("sx", "sy"), np.asarray(rays.sigmas)),
        *numbers(V, figures.residuals[0], V, show=with_digits(4)),
        of_page("", _units_of_rays(figures)),
        of_page(size_name, size, lambda value: f"{value:.2f}"),
    ]
    if reliability:
        columns += numbers(("rx", "ry"), reliability.redundancy_numbers[0]) + numbers(("wx", "wy"), reliability.w[0])
    worst = worst[np.argsort(-size[worst], kind="stable")]
    table = ReportTable("rays", tuple(columns), worst[:WORST], rows=worst)
    return Section(f"Rays with the largest {size_name}", (table,), Chapter.RESIDUALS)


def reliability_section(figures: Figures) -> Section:
    """A table of the redundancy numbers of each group: number, sum, mean, minimum, and maximum |w| and MDE."""
    adjustment, rows, names = figures.adjustment, [], []
    found = figures.reliability[:3] if figures.reliability and not adjustment.undetermined else ()
    for group in default_groups(adjustment.block) if found else ():
        r, w, mde = (
            np.concatenate([table[mask] for table, mask in zip(tables, group.masks, strict=True)]) for tables in found
        )
        uncontrolled, largest = int((~(r > UNCONTROLLED)).sum()), np.nanmax(np.abs(w), initial=0.0)
        largest_w = float(largest) / max(figures.sigma0, SMALLEST)
        rows.append((len(r), r.sum(), r.mean(), r.min(), uncontrolled, largest_w, mde.max(initial=0.0)))
        names.append(group.name)
    heads = (
        ("observations", "number", "{}"),
        ("redundancy", "sum r", "{:.2f}"),
        ("mean", "mean r", "{:.3f}"),
        ("smallest", "min r", "{:.3f}"),
        ("uncontrolled", "r < 0.04", "{}"),
        ("largest_w", "max |w|/sigma0", "{:.2f}"),
        ("largest_mde", "max MDE", "{:.4g}"),
    )
    columns = [
        ReportColumn(name, np.array([row[k] for row in rows]), head, form.format, is_result=True)
        for k, (name, head, form) in enumerate(heads)
    ]
    every = np.arange(len(rows))
    table = ReportTable(
        "reliability", (name_column("group", names, 100), *columns), every, results=every, in_file=False
    )
    return Section("Reliability", (table,), Chapter.RELIABILITY)


def _correlations(figures: Figures) -> Section:
    """Correlations of interior elements and high correlations of parameters; the text shows only high ones."""
    elements = [(figures.camera_names[c], f"{a},{b}", r, a, b) for c, a, b, r in figures.correlations()]
    of_parameters = correlated_parameters(figures.adjustment)
    pairs = [*elements, *(("", "", r, a, b) for a, b, r in of_parameters)]
    camera, both, r, a, b = (list(column) for column in zip(*pairs, strict=True)) if pairs else ([],) * 5
    high = np.flatnonzero(np.abs(np.array(r)) > HIGH_CORRELATION)
    columns = (
        name_column("camera", camera),
        ReportColumn("elements", both, is_name=True),
        *(
            ReportColumn("", pair, "", partial(short, longest=PARAMETER), 0, is_name=True, in_file=False)
            for pair in (a, b)
        ),
        ReportColumn("correlation", np.array(r), "correlation", "{:.4f}".format, is_result=True),
    )
    shown = first(high, PAIRS, "pairs")
    table = ReportTable("correlations", columns, *shown, results=np.arange(len(elements)), in_file=False)
    entries = fact("", "", high_parameter_correlations=of_parameters)
    return Section(f"Correlations above {HIGH_CORRELATION}", (Facts((entries,), 0), table), Chapter.CAMERAS)
