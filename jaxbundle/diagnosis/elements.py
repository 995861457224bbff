"""Findings about estimated elements of cameras and parameters: weak, highly correlated or insignificant ones."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.depths import viewing_directions
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.block.wording import counted, figure, named
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.significance import NEVER_ZERO, insignificant, tested_parameters

HIGH_CORRELATION = 0.95
SEVERAL = 3  # maximum number of cameras with their own finding
WEAK_DISTANCE = 0.01  # ratio of sd and principal distance: flying heights and depths have the same relative uncertainty
CONVERGENT = 0.87  # cosine of 30 degrees between two camera axes: such convergence separates c, x0, y0
TURNED = 0.5  # cosine of 60 degrees between the x axes of two photographs


def element_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about cameras, then about parameters; none without standard deviations."""
    if adjustment.cofactors is None:
        return ()
    return (
        *_together(_weak(adjustment)),
        *_together(_correlated_elements(adjustment)),
        *_correlated_parameters(adjustment),
        *_together(_insignificant_elements(adjustment)),
        *_insignificant_parameters(adjustment),
        *_loose_parameters(adjustment),
    )


def _together(found: list[Finding]) -> list[Finding]:
    """Findings of one kind, one for each camera; one common finding for many cameras."""
    if len(found) <= SEVERAL:
        return found
    cameras = [finding.subjects[0].names[0] for finding in found[1:]]
    subjects = tuple(subject for finding in found for subject in finding.subjects)
    what = f"{found[0].what}; likewise in {len(cameras)} more cameras: {named(cameras)}"
    return [dataclasses.replace(found[0], what=what, subjects=subjects)]


def _undetermined(adjustment: Adjustment) -> set[Subject]:
    return {subject for finding in adjustment.undetermined for subject in finding.subjects}


def _weak(adjustment: Adjustment) -> list[Finding]:
    """Findings about principal distances with a large standard deviation."""
    structure, found = adjustment.block.structure, []
    sd, values = np.asarray(adjustment.standard_deviations.interior), np.asarray(adjustment.block.interior.elements)
    for c, camera in enumerate(structure.cameras):
        if "principal_distance" not in camera.model.elements:
            continue
        k = camera.model.elements.index("principal_distance")
        share = abs(sd[c, k] / values[c, k]) if structure.interior_free[c, k] else 0.0
        if not share > WEAK_DISTANCE:
            continue
        unit = camera.unit_of("principal_distance")
        what = (
            f"principal_distance of camera {camera.name} is {figure(values[c, k], 6)} +- {figure(sd[c, k])} {unit}"
            f" ({share:.0%}): it is hardly separated from the distances of the stations to the points"
        )
        cure = "fix it or give it a prior, or add control in relief or convergent images"
        subject = Subject("cameras", (camera.name,), "principal_distance")
        found.append((share, Finding(Kind.WEAK, what, cure, (subject,), float(sd[c, k]), unit)))
    return [finding for _, finding in sorted(found, key=lambda pair: -pair[0])]


def is_convergent(block: Block) -> bool:
    """Whether some camera axes intersect at more than 30 degrees and some photographs are rotated about their axes."""
    axes = viewing_directions(block)
    sideways = np.asarray(unknowns_of(block).rotation).reshape(3, 3, -1)[:, 0].T
    return bool((axes @ axes[0]).min() < CONVERGENT and np.abs(sideways @ sideways[0]).min() < TURNED)


def _correlated_elements(adjustment: Adjustment) -> list[Finding]:
    """One finding for each camera with highly correlated elements."""
    structure, matrices = adjustment.block.structure, np.asarray(adjustment.interior_correlations)
    add = "" if is_convergent(adjustment.block) else ", or add convergent and rotated images"
    found, undetermined = [], _undetermined(adjustment)
    for c, camera in enumerate(structure.cameras):
        free, names = np.flatnonzero(structure.interior_free[c]), camera.model.elements
        own = {k for k in free if Subject("cameras", (camera.name,), names[k]) in undetermined}
        pairs = [(i, j) for n, i in enumerate(free) for j in free[n + 1 :] if not own & {i, j}]
        pairs = [(i, j) for i, j in pairs if abs(matrices[c, i, j]) > HIGH_CORRELATION]
        pairs.sort(key=lambda pair: -abs(matrices[c, pair[0], pair[1]]))
        if pairs:
            listed = named([f"{names[i]} and {names[j]} by {matrices[c, i, j]:.3f}" for i, j in pairs])
            subjects = dict.fromkeys(Subject("cameras", (camera.name,), names[k]) for pair in pairs for k in pair)
            what = f"elements of camera {camera.name} are highly correlated: {listed}"
            size = float(matrices[c, pairs[0][0], pairs[0][1]])
            found.append(Finding(Kind.CORRELATED, what, f"fix one of each pair{add}", tuple(subjects), size))
    return sorted(found, key=lambda finding: -abs(finding.size))


def correlations_of(covariance: Float[np.ndarray, "element element"]) -> Float[np.ndarray, "element element"]:
    """Correlations of a covariance matrix; 0 where a variance is 0 or unknown."""
    variance = np.diagonal(covariance)
    known = variance > 0
    scale = np.where(known, 1 / np.sqrt(np.where(known, variance, 1.0)), 0.0)
    return np.nan_to_num(scale[:, None] * covariance * scale)


def correlated_parameters(adjustment: Adjustment) -> list[tuple[str, str, float]]:
    """Pairs of parameters with a high correlation, the highest first."""
    names = [parameter.name for parameter in adjustment.block.structure.parameters]
    if adjustment.cofactors is None or not names:
        return []
    r = np.triu(correlations_of(np.asarray(adjustment.cofactors.parameters)), 1)
    rows, columns = np.nonzero(np.abs(r) > HIGH_CORRELATION)
    order = np.argsort(-np.abs(r[rows, columns]), kind="stable")
    return [(names[a], names[b], float(r[a, b])) for a, b in zip(rows[order], columns[order], strict=True)]


def _correlated_parameters(adjustment: Adjustment) -> list[Finding]:
    pairs = correlated_parameters(adjustment)
    if not pairs:
        return []
    listed = named([f"{a} and {b} by {r:.3f}" for a, b, r in pairs])
    subjects = dict.fromkeys(Subject("parameters", (name,)) for a, b, _ in pairs for name in (a, b))
    cure = "fix one of each pair, or give it a value with a sigma"
    return [Finding(Kind.CORRELATED, f"parameters are highly correlated: {listed}", cure, tuple(subjects), pairs[0][2])]


def _insignificant_elements(adjustment: Adjustment) -> list[Finding]:
    """Findings about coefficients of a camera that may be fixed at 0, tested together."""
    assert adjustment.cofactors is not None
    structure, found, undetermined = adjustment.block.structure, [], _undetermined(adjustment)
    variance = float(adjustment.sigma0) ** 2
    values, cofactors = np.asarray(adjustment.block.interior.elements), np.asarray(adjustment.cofactors.interior)
    for c, camera in enumerate(structure.cameras):
        names = camera.model.elements
        tested = [
            k
            for k in np.flatnonzero(structure.interior_free[c])
            if names[k] not in NEVER_ZERO
            and Subject("cameras", (camera.name,), names[k]) not in undetermined
            and cofactors[c, k, k] > 0
        ]
        held, _ = insignificant(values[c, tested], variance * cofactors[c][np.ix_(tested, tested)])
        if held:
            subjects = tuple(Subject("cameras", (camera.name,), names[tested[k]]) for k in held)
            found.append(_at_zero([s.component for s in subjects], f" of camera {camera.name}", subjects))
    return found


def _insignificant_parameters(adjustment: Adjustment) -> list[Finding]:
    assert adjustment.cofactors is not None
    tested = np.flatnonzero(tested_parameters(adjustment))
    undetermined = _undetermined(adjustment)
    names = [adjustment.block.structure.parameters[k].name for k in tested]
    keep = [i for i, name in enumerate(names) if Subject("parameters", (name,)) not in undetermined]
    tested, names = tested[keep], [names[i] for i in keep]
    covariance = float(adjustment.sigma0) ** 2 * np.asarray(adjustment.cofactors.parameters)[np.ix_(tested, tested)]
    held, _ = insignificant(np.asarray(adjustment.block.parameters)[tested], covariance)
    if not held:
        return []
    subjects = tuple(Subject("parameters", (names[k],)) for k in held)
    return [_at_zero([names[k] for k in held], "", subjects)]


def _at_zero(names: list[str], owner: str, subjects: tuple[Subject, ...]) -> Finding:
    one = len(names) == 1
    what = f"{named(names)}{owner} {'is' if one else 'are together'} not significant (below 2 sd)"
    return Finding(Kind.INSIGNIFICANT, what, f"fix {'it' if one else 'them'} at 0", subjects)


def _loose_parameters(adjustment: Adjustment) -> list[Finding]:
    """The finding about parameters without a standard deviation that are not reported as undetermined."""
    assert adjustment.cofactors is not None
    structure, undetermined = adjustment.block.structure, _undetermined(adjustment)
    variance = np.diagonal(np.asarray(adjustment.cofactors.parameters))
    loose = np.flatnonzero(structure.parameter_free & ~np.isfinite(variance)) if len(structure.parameters) else []
    subjects = tuple(Subject("parameters", (structure.parameters[k].name,)) for k in loose)
    subjects = tuple(subject for subject in subjects if subject not in undetermined)
    if not subjects:
        return []
    listed = named([subject.names[0] for subject in subjects])
    what = f"{counted(len(subjects), 'parameter')} without a standard deviation: {listed}"
    return [Finding(Kind.WEAK, what, "fix these parameters, or give them a value with a sigma", subjects)]
