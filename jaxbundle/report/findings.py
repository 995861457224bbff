"""Problems of an adjustment and suggestions, in words: what a report opens with.

The global test holds v^T P v against the chi-square distribution of M - N degrees of freedom, two-sided at 5 %: with
sigmas that are right, sigma0 lies between the limits in 95 of 100 adjustments (Kraus 2007, app. 4.2).
"""

from collections import Counter
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from jaxbundle.report.diagnosis import diagnosis
from jaxbundle.report.figures import HIGH_CORRELATION, Figures, figures_of
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment, Status

LEVEL = 0.05
SIGNIFICANT = 2.0  # standard deviations: an element below is as good as 0
OUTLYING = 4.0  # of sigma0 sigma; normal errors exceed it once in 16 thousand
CHANCE = 6.3e-5  # the probability of that
ILL_FITTING = 2.0  # residuals of rays of control points over those of tie points
FEW = 10  # rays: fewer say nothing
NAMED = 5  # examples in one sentence
SENTENCES = 10  # of one kind, and names in one sentence about what is not determined
NO_ERRORS = 1e-6  # sigma0 of observations that have none: residuals are rounding
CURES = {
    Status.MAXIMUM_ITERATIONS: "allow more iterations, or give better approximate values",
    Status.SINGULAR: "hold what the observations do not determine, or use the Levenberg-Marquardt method",
    Status.DIVERGED: "give better approximate values, or use the Levenberg-Marquardt method",
    Status.STALLED: "look for gross errors among the worst residuals and for unknowns that are hardly determined",
    Status.CREEPING: "add control, or observed stations, where the datum is weak",
    Status.INTERRUPTED: "start again from the adjusted values",
}


class Finding(NamedTuple):
    """`kind`: "not converged" and "undetermined" forbid trust; "suggestion", "note"."""

    kind: str
    words: str

    @property
    def label(self) -> str:
        """ "problem", "suggestion" or "note"."""
        return self.kind if self.kind in ("suggestion", "note") else "problem"


class GlobalTest(NamedTuple):
    """sigma0 and the limits between which it should lie."""

    sigma0: float
    lower: float
    upper: float

    @property
    def passed(self) -> bool:
        """Whether sigma0 agrees with the a-priori sigmas."""
        return self.lower <= self.sigma0 <= self.upper


def global_test(sigma0: float, redundancy: int) -> GlobalTest:
    """The test of sigma0 against 1."""
    lower, upper = np.sqrt(chdtri(redundancy, [1 - LEVEL / 2, LEVEL / 2]) / redundancy)
    return GlobalTest(sigma0, float(lower), float(upper))


def findings(adjustment: Adjustment) -> list[Finding]:
    """Problems first, then suggestions and notes."""
    return findings_of(figures_of(adjustment))


def findings_of(figures: Figures) -> list[Finding]:
    """`findings` from numbers that are converted already."""
    status = figures.adjustment.status
    found = []
    if status is not Status.CONVERGED:
        found.append(Finding("not converged", f"the adjustment {status.words}; {CURES[status]}"))
    found += [Finding("undetermined", f"not determined: {sentence}") for sentence in _undetermined(figures)]
    suggestions = [*_outlying(figures), *_down_weighted(figures), *_unsettled(figures)]
    if status is Status.CONVERGED:
        suggestions = [
            *_sigma0(figures),
            *suggestions,
            *_ill_fitting_control(figures),
            *diagnosis(figures),
            *_correlated(figures),
            *_insignificant(figures),
            *_insignificant_parameters(figures),
        ]
    found += [Finding("suggestion", words) for words in (*suggestions, *_seen_twice(figures))]
    if figures.adjustment.cofactors is None:
        found.append(Finding("note", "no standard deviations were computed"))
    return found + [Finding("note", note.words) for note in figures.structure.findings]


def _undetermined(figures: Figures) -> list[str]:
    """What is not determined, with one sentence for all that has the same cure."""
    by_cure: dict[str, list[str]] = {}
    for found in figures.adjustment.undetermined:
        by_cure.setdefault(found.cure, []).append(found.what)
    return [f"{_listed(names)}; {cure}" for cure, names in by_cure.items()]


def _listed(names: list[str]) -> str:
    more = len(names) - SENTENCES
    return ", ".join(names[:SENTENCES]) + (f" and {more} more" if more > 0 else "")


def _sigma0(figures: Figures) -> list[str]:
    test = global_test(figures.sigma0, figures.adjustment.redundancy)
    if test.passed or (figures.weights is not None and test.sigma0 < test.lower):
        return []  # robust weights make residuals small by themselves
    limits = f"the sigmas given promise {test.lower:.4g} to {test.upper:.4g}"
    if test.sigma0 > test.upper:
        return [
            f"sigma0 is {test.sigma0:.4g}, {limits}: the observations are worse than their sigmas, or gross or"
            " systematic errors are left; look at the worst residuals, else enlarge the sigmas"
        ]
    return [f"sigma0 is {test.sigma0:.4g}, {limits}: the observations are better than their sigmas; reduce the sigmas"]


def _outlying(figures: Figures) -> list[str]:
    structure = figures.structure
    size = figures.ray_size if figures.sigma0 > NO_ERRORS else np.zeros(0)
    rays = np.flatnonzero(size > OUTLYING)
    if not len(rays):
        return []
    worst = rays[np.argsort(-size[rays], kind="stable")[:NAMED]]
    named = "; ".join(
        f"point {structure.point_names[structure.ray_point[ray]]} on image"
        f" {structure.image_names[structure.ray_image[ray]]} ({size[ray]:.1f})"
        for ray in worst
    )
    expected = 2 * len(size) * CHANCE
    chance = f", of normal errors {expected:.0f} would be" if expected >= 1 else ""
    how_many = "1 ray is" if len(rays) == 1 else f"{len(rays)} rays are"
    return [
        f"{how_many} off by more than {OUTLYING:.0f} sigma0 sigma{chance}: {named}{_and_more(rays)};"
        " measure again or drop what is no error of measurement"
    ]


def _and_more(items: np.ndarray) -> str:
    return f" and {len(items) - NAMED} more" if len(items) > NAMED else ""


def _unsettled(figures: Figures) -> list[str]:
    """Robust weights that were still changing at the end."""
    robust = figures.adjustment.reweighting
    if robust is None or robust.settled:
        return []
    return [
        f"the robust weights were still changing after {robust.rounds} rounds: take another weight function or a larger"
        " limit"
    ]


def _down_weighted(figures: Figures) -> list[str]:
    rays, weights, structure = figures.down_weighted, figures.weights, figures.structure
    if weights is None or not len(rays):
        return []
    named = "; ".join(
        f"point {structure.point_names[structure.ray_point[ray]]} on image"
        f" {structure.image_names[structure.ray_image[ray]]} ({weights[ray]:.2g})"
        for ray in rays[:NAMED]
    )
    how_many = "1 ray has" if len(rays) == 1 else f"{len(rays)} rays have"
    return [
        f"{how_many} a robust weight below {DOWN_WEIGHTED:g}: {named}{_and_more(rays)}; measure again or drop what"
        " is no error of measurement, and adjust by least squares"
    ]


def _ill_fitting_control(figures: Figures) -> list[str]:
    of_control = figures.control_point[figures.structure.ray_point]
    control, tie = figures.normalised[0][of_control], figures.normalised[0][~of_control]
    if min(len(control), len(tie)) < FEW or figures.sigma0 <= NO_ERRORS:
        return []
    ratio = float(np.sqrt(np.mean(control**2) / np.mean(tie**2)))
    if ratio < ILL_FITTING:
        return []
    return [
        f"rays of control points fit {ratio:.1f} times worse than those of tie points: coordinates of control points"
        " are less accurate than their sigmas, or wrong; check them or enlarge their sigmas"
    ]


def _correlated(figures: Figures) -> list[str]:
    high = [pair for pair in figures.correlations() if abs(pair[3]) > HIGH_CORRELATION]
    high.sort(key=lambda pair: -abs(pair[3]))
    return _capped(
        [
            f"{a} and {b} of camera {figures.structure.cameras[c].name} are correlated by {r:.3f}: hold one of them, or"
            " add convergent and turned images"
            for c, a, b, r in high
        ]
        + [
            f"{a} and {b} are correlated by {r:.3f}: hold one of them, or give it a value with a sigma"
            for a, b, r in figures.parameter_correlations()
        ],
        "highly correlated pairs",
    )


def _insignificant(figures: Figures) -> list[str]:
    values, sd = np.abs(figures.interior), figures.interior_sd
    small = figures.structure.interior_free & (values < SIGNIFICANT * sd)
    sentences = []
    for c in np.flatnonzero(small.any(1)):
        camera = figures.structure.cameras[c]
        names = [camera.model.elements[k] for k in np.flatnonzero(small[c])]
        be, it = ("is", "it") if len(names) == 1 else ("are", "them")
        listed = ", ".join(names)
        sentences.append(
            f"{listed} of camera {camera.name} {be} not significant (below {SIGNIFICANT:.0f} sd): hold {it} at 0"
        )
    return _capped(sentences, "cameras with insignificant elements")


def _insignificant_parameters(figures: Figures) -> list[str]:
    parameters, told = figures.structure.parameters, " ".join(found.what for found in figures.adjustment.undetermined)
    if figures.adjustment.cofactors is None:
        return []
    small = [parameters[k].name for k in np.flatnonzero(figures.significance < SIGNIFICANT)]
    loose = np.flatnonzero(figures.structure.parameter_free & ~np.isfinite(figures.parameters_sd))
    loose = [parameters[k].name for k in loose if parameters[k].name not in told]
    sentences = []
    if small:
        be, it = ("is", "it") if len(small) == 1 else ("are", "them")
        sentences.append(f"{_listed(small)} {be} not significant (below {SIGNIFICANT:.0f} sd): hold {it} at 0")
    if loose:
        cure = "hold what has none, or give it a value with a sigma"
        sentences.append(f"no standard deviation can be given of {_listed(loose)}: {cure}")
    return sentences


def _capped(sentences: list[str], what: str) -> list[str]:
    more = len(sentences) - SENTENCES
    return [*sentences[:SENTENCES], f"... and {more} more {what}"] if more > 0 else sentences


def _seen_twice(figures: Figures) -> list[str]:
    rays = Counter(figures.rays_of_point[figures.unknown_points].tolist())
    points = sum(rays.values())
    if 2 * rays[2] <= points:
        return []
    return [
        f"{rays[2]} of {points} points are on two images only: an error along the base moves such a point and shows in"
        " no residual; measure more points on three images"
    ]
