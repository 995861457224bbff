"""Findings about the suspect observations of a converged adjustment, the most probable error first."""

from collections.abc import Callable, Iterable

import numpy as np

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.statistics.hypotheses import Cause
from jaxbundle.statistics.suspects import MOST, SHOWN, Suspects, Suspicion

NAMED = 5  # maximum number of suspicions with their own finding
ALTERNATIVES = 3  # maximum number of names in one finding
SINGLE = {  # table -> words for a row of it
    "rays": "the ray of point {1} on image {0}",
    "control": "control point {0}",
    "stations": "the station of image {0}",
    "attitudes": "the attitude of image {0}",
    "images": "the rays of image {0} as a whole",
    "cameras": "the rays of camera {0} as a whole",
    "navigation": "the navigation data of {0}",
    "bars": "the length of scale bar {0}",
    "interior": "the observed interior elements of camera {0}",
    "parameters": "the observed value of {0}",
    "scale_bars": "the scale bar between {0} and {1}",
    "distances": "the distance between {0} and {1}",
    "horizontal_distances": "the horizontal distance between {0} and {1}",
    "height_differences": "the height difference between {0} and {1}",
    "azimuths": "the azimuth from {0} to {1}",
    "directions": "the direction from {0} to {1}",
    "zenith_angles": "the zenith angle from {0} to {1}",
    "plumb_lines": "the plumb line through {0} and {1}",
    "planes": "point {0} of a plane",
    "lines": "point {0} of a line",
}
TOGETHER = {"control": "all control points", "stations": "all stations", "attitudes": "all attitudes"}
CURES = {
    "rays": "re-measure or remove it",
    "control": "check its coordinates, its name and where it was measured on the images, or remove it",
}


def findings_of_suspects(suspects: Suspects, sigma0: float) -> tuple[Finding, ...]:
    """Findings about probably wrong observations: one for each of the first suspicions, and one that counts the others.

    `sigma0`: of the adjustment.
    """
    named, rest = suspects.suspicions[:NAMED], suspects.suspicions[NAMED:]
    before = [sigma0, *(suspicion.sigma0_without for suspicion in named)]
    found = [_finding(suspicion, sigma0) for suspicion, sigma0 in zip(named, before, strict=False)]
    if rest:
        at_least = "at least " if len(suspects.suspicions) >= MOST else ""
        one = len(rest) == 1 and not at_least
        count = f"{at_least}{len(rest)} more observation{' is' if one else 's are'} suspect"
        what = f"{count}; without all suspect observations sigma0 is {suspects.sigma0:.3g}"
        subjects = tuple(subject for suspicion in rest for subject in suspicion.subjects)
        found.append(Finding(Kind.SUSPECT, what, "check the first ones, and adjust again", subjects))
    return tuple(found)


def _finding(s: Suspicion, sigma0: float) -> Finding:
    words: dict[Cause, Callable[[Suspicion], str]] = {
        Cause.VALUE: _wrong_value,
        Cause.AXES: _exchanged_axes,
        Cause.NAMES: _exchanged_names,
        Cause.SHIFT: _shift,
        Cause.SCALE: _scale,
        Cause.IMAGE: _image,
    }
    kind = Kind.SUSPECT if s.cause in (Cause.VALUE, Cause.AXES, Cause.NAMES) else Kind.SYSTEMATIC
    what = f"{words[s.cause](s)}; without {_it(s)} sigma0 falls from {sigma0:.4g} to {s.sigma0_without:.4g}"
    told = np.abs(np.nan_to_num(s.error))
    place = int(np.argmax(told / np.where(s.deviations > 0, s.deviations, np.inf))) if len(told) else 0
    alternatives = (subject for subjects in s.alternatives for subject in subjects)
    return Finding(kind, what, _cure(s), (*s.subjects, *alternatives), float(s.error[place]), s.units[place])


def _it(s: Suspicion) -> str:
    if s.cause in (Cause.AXES, Cause.NAMES):
        return "this mistake"
    if s.cause in (Cause.SHIFT, Cause.SCALE, Cause.IMAGE):
        return "this disagreement"
    return "this observation" if len(s.components) == 1 or s.subjects[0].table == "rays" else "it"


def _cure(s: Suspicion) -> str:
    if s.alternatives:
        return "check all of them; the observations cannot distinguish between them"
    table = s.subjects[0].table
    if s.cause is Cause.SHIFT:
        return "check datum, heights (ellipsoidal or levelled), units and offsets, or estimate a shift"
    if s.cause is Cause.IMAGE:
        return "check resolution, format and principal distance of their camera"
    if s.cause is Cause.SCALE:
        return "check their unit and the reduction to the map"
    if s.cause is Cause.NAMES:
        return "exchange them back"
    if s.cause is Cause.AXES:
        return "exchange them back"
    return CURES.get(table, "check it or remove it")


def _named(subject: Subject) -> str:
    if not subject.names:
        return TOGETHER.get(subject.table, f"all {subject.table.replace('_', ' ')}")
    words = SINGLE.get(subject.table)
    return words.format(*subject.names) if words else f"{subject.table} {' - '.join(subject.names)}"


def _either(s: Suspicion) -> str:
    """Words for the subject, or for all possible subjects."""
    own = _named(s.subjects[0])
    if not s.alternatives:
        return own
    others = [" and ".join(map(_named, subjects)) for subjects in s.alternatives[:ALTERNATIVES]]
    more = len(s.alternatives) - ALTERNATIVES
    others += [f"one of {more} others"] if more > 0 else []
    return f"either {own} or {' or '.join(others)}"


def _wrong_value(s: Suspicion) -> str:
    return f"{_either(s)} is wrong{_by(s)}"


def _by(s: Suspicion) -> str:
    """The size of the error, or the reason why it is unknown."""
    whose = f" {_named(s.subjects[0])}:" if s.alternatives else ""
    if np.isnan(s.error).all():
        part = f"{100 * s.shown:.1g} %" if s.shown > SHOWN / 1000 else "nothing"
        return f" by an error of unknown size (the residuals contain {part} of it)"
    sizes = _sizes(zip(s.components, s.error, s.deviations, s.units, strict=True))
    return f" ({whose[1:]} {sizes})" if whose else f" by {sizes}"


def _sizes(parts: Iterable[tuple[str, float, float, str]]) -> str:
    """An error in words, such as "X +1.07 m (sd 0.06 m)"."""
    return ", ".join(
        f"{name} {_number(size, sd)}{_unit(unit)} (sd {sd:.1g}{_unit(unit)})" for name, size, sd, unit in parts
    )


def _number(size: float, sd: float) -> str:
    """A number rounded to the digits of its standard deviation."""
    if not sd > 0 or not np.isfinite(sd):
        return f"{size:+.3g}"
    digits = int(np.clip(-np.floor(np.log10(sd)), 0, 9))
    return f"{size:+.{digits}f}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _exchanged_axes(s: Suspicion) -> str:
    axes = "x and y" if s.subjects[0].table == "rays" else "X and Y"
    return f"{axes} of {_named(s.subjects[0])} are exchanged"


def _exchanged_names(s: Suspicion) -> str:
    one, two = s.subjects[:2]
    if one.table == "rays":
        return f"the names of points {one.names[1]} and {two.names[1]} are exchanged on image {one.names[0]}"
    return f"the names or coordinates of control points {one.names[0]} and {two.names[0]} are exchanged"


def _shift(s: Suspicion) -> str:
    if s.subjects[0].table == "bars":
        return f"{_either(s)} is wrong{_by(s)}"
    return f"{_either(s)} disagree with the other observations by a common shift{_by(s).replace(' by ', ' of ', 1)}"


def _scale(s: Suspicion) -> str:
    if np.isnan(s.error).all():
        return f"{_either(s)} are wrong by a common factor"
    return f"{_either(s)} are too long by the common factor {1 + s.error[0]:.6g} (sd {s.deviations[0]:.1g})"


def _image(s: Suspicion) -> str:
    return f"{_either(s)} do not fit the other observations{_by(s).replace(' by ', ': ', 1)}"
