"""The first part of the page: tiles with the verdict, and the findings with links to their subjects."""

import numpy as np

from jaxbundle.block.findings import Finding, Severity
from jaxbundle.diagnosis.sigmas import global_test
from jaxbundle.report.figures import Figures
from jaxbundle.report.html.html_tables import Rows
from jaxbundle.report.html.markup import tag, text
from jaxbundle.report.pictures.vector_pictures import check_vectors, control_vectors, external_test, spread
from jaxbundle.report.section import Chapter

LINKS = 6  # maximum number of links of one finding
SIGNS = {Severity.FAILED: "\u2715", Severity.CHECK: "!", Severity.NOTE: "i"}
# chapter of the subject of a finding, if its row is not in the page
CHAPTER_OF = {
    "control": Chapter.CONTROL,
    "check_points": Chapter.CONTROL,
    "rays": Chapter.RESIDUALS,
    "images": Chapter.IMAGES,
    "cameras": Chapter.CAMERAS,
    "points": Chapter.POINTS,
}


def tiles(figures: Figures) -> str:
    """Tiles: status, sigma0, residuals at control (internal), differences at check points (external), findings."""
    adjustment = figures.adjustment
    good = adjustment.trustworthy and not any(f.severity is Severity.FAILED for f in figures.findings)
    use = "can be used" if good else "must not be used"
    status = adjustment.status.name.lower().replace("_", " ")
    test = global_test(figures.sigma0, adjustment.redundancy)
    passed = "inside" if test.passed else "outside"
    limits = f"{passed} {test.lower:.3f} to {test.upper:.3f}"
    number = {severity: sum(f.severity is severity for f in figures.findings) for severity in Severity}
    found = ", ".join(f"{count} {severity.label}" for severity, count in number.items() if count) or "none"
    parts = [
        _tile("Status", status, f"the result {use}", "good" if good else "failed", "\u2713" if good else "\u2715"),
        _tile("sigma0", f"{figures.sigma0:.6g}", limits, "good" if test.passed else "check"),
        _control_tile(figures),
        _check_tile(figures),
        _tile("Findings", str(len(figures.findings)), found, "failed" if number[Severity.FAILED] else ""),
    ]
    return tag("div", parts, class_="tiles")


def _tile(label: str, value: str, below: str, kind: str, sign: str = "") -> str:
    shown = tag("span", sign, class_="sign", aria_hidden="true") + " " if sign else ""
    words = " ".join(tag("span", text(part), class_="whole") for part in value.split("  "))
    inside = tag("h4", text(label)) + tag("p", shown + words, class_="value") + tag("p", text(below))
    return tag("div", inside, class_=f"tile {kind}".strip())


def _rms(values: tuple[float, ...]) -> str:
    return "  ".join(f"{c} {x:.3g}" for c, x in zip("XYZ", values, strict=True) if np.isfinite(x))


def _control_tile(figures: Figures) -> str:
    vectors = control_vectors(figures)
    if not vectors.names:
        return _tile("Control points, rms", "none observed", "no control took part", "internal")
    unit, found = figures.structure.object_unit, spread(vectors)
    below = f"{unit}, {len(vectors.names)} points; internal: used in the adjustment"
    return _tile("Control points, rms", _rms(found.rms), below, "internal")


def _check_tile(figures: Figures) -> str:
    vectors = check_vectors(figures)
    if not vectors.names:
        return _tile("Check points, rms", "none", "external accuracy is unknown", "external")
    unit, found = figures.structure.object_unit, spread(vectors)
    _, count, probability = external_test(vectors)
    verdict = f"; chi-square test: {chance(probability)}" if count else ""
    below = f"{unit}, {len(vectors.names)} points{verdict}; external"
    return _tile("Check points, rms", _rms(found.rms), below, "external")


def chance(probability: float) -> str:
    """A probability in a sentence."""
    return "p < 0.0001" if probability < 1e-4 else f"p = {probability:.2g}"


def findings_html(figures: Figures, rows: Rows) -> str:
    """The findings in their order, with links to their rows."""
    if not figures.findings:
        return tag("p", "There are no problems and no suggestions.")
    items = []
    for finding in figures.findings:
        severity = finding.severity
        sign = tag("span", SIGNS[severity], class_="sign", aria_hidden="true")
        label = tag("span", f"{sign} {severity.label}", class_=f"chip {severity.label}")
        what, cure = (
            tag("p", text(words[:1].upper() + words[1:]) + ".", class_=kind) if words else ""
            for words, kind in ((finding.what, None), (finding.cure, "cure"))
        )
        items.append(tag("li", label + tag("div", what + cure + _links(finding, rows))))
    return tag("ol", items, class_="findings")


def _links(finding: Finding, rows: Rows) -> str:
    links = []
    for subject in finding.subjects:
        address = rows.get((subject.table, subject.names)) or rows.get(("check_points", subject.names))
        if address is None and subject.table in CHAPTER_OF:
            address = chapter_address(CHAPTER_OF[subject.table])
        what = subject.table.replace("_", " ").removesuffix("s")
        words = " ".join(filter(None, (what, *subject.names, subject.component)))
        if address is not None:
            links.append(tag("a", text(words), href=f"#{address}"))
    links = list(dict.fromkeys(links))
    more = f" and {len(links) - LINKS} more" if len(links) > LINKS else ""
    return tag("p", ", ".join(links[:LINKS]) + more, class_="links") if links else ""


def chapter_address(chapter: Chapter) -> str:
    """The id of a chapter within the page."""
    return f"chapter-{list(Chapter).index(chapter) + 1}"
