"""What the reliability of the observations says, in words: suspect ones, uncontrolled ones, groups of wrong sigmas.

estimated error    -v / r                                  of the one observation that is wrong, all others right
sigma0 without it  sqrt((v^T P v - w^2) / (M - N - 1))     as its removal would leave it
a group            sum v^2 P / sum r = sigma0^2            chi-square of sum r degrees of freedom
"""

import numpy as np
from scipy.special import chdtrc

from jaxbundle.report.figures import Figures
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.statistics.reliability import UNCONTROLLED, critical_w, level_of_one, redundancy_numbers, reliability
from jaxbundle.statistics.snooping import describe
from jaxbundle.statistics.subsets import three_groups

LEVEL = 0.05  # of all tests of a report together
NAMED = 5
FEW = 3.0  # redundancy: a group of less says nothing of its sigma
NO_ERRORS = 1e-6  # sigma0 of observations without errors: residuals are rounding


def diagnosis(figures: Figures) -> list[str]:
    """Sentences with suggestions, the gravest first; none where there are no redundancy numbers."""
    adjustment = figures.adjustment
    if adjustment.redundancy_numbers is None or adjustment.status is not Status.CONVERGED or adjustment.undetermined:
        return []
    quiet = adjustment.redundancy < 2 or figures.sigma0 < NO_ERRORS or adjustment.reweighting is not None
    found = [] if quiet else [*_suspects(adjustment, figures), *_groups(adjustment, figures)]
    return [*found, *_uncontrolled(adjustment)]


def _suspects(adjustment: Adjustment, figures: Figures) -> list[str]:
    """Control and other observations that disagree; rays are told by their residuals."""
    tables = reliability(adjustment)
    limit = critical_w(level_of_one(LEVEL, adjustment.observations)) * max(figures.sigma0, 1.0)
    sentences = []
    for k in range(1, len(tables.w)):
        w, r = tables.w[k], tables.redundancy_numbers[k]
        large = np.where(r > UNCONTROLLED, np.abs(w), 0.0)
        if adjustment.block.groups[k - 1].covariances is not None:
            continue  # the w of correlated components belong to combinations of them
        suspect = np.argwhere(large > limit)[np.argsort(-large[large > limit], kind="stable")]
        for row, component in suspect.tolist():
            names, table, what = describe(adjustment.block, k, row, component)
            error = -float(adjustment.residuals[k][row, component]) / float(r[row, component])
            left = (figures.vtpv - float(w[row, component]) ** 2) / (adjustment.redundancy - 1)
            sentences.append(
                f"{table} {' - '.join(names)} disagrees by {error:.4g} in {what} (w = {w[row, component]:.1f});"
                f" its removal lowers sigma0 from {figures.sigma0:.4g} to {np.sqrt(max(left, 0.0)):.4g}:"
                " check it or drop it"
            )
    return sentences[:NAMED]


def _groups(adjustment: Adjustment, figures: Figures) -> list[str]:
    """Groups whose residuals do not fit to their sigmas as those of the whole block do."""
    numbers = redundancy_numbers(adjustment)
    squared = [np.asarray(v) ** 2 for v in adjustment.weighted_residuals]
    sentences = []
    for group in three_groups(adjustment.block):
        redundancy, squares = (
            float(sum(t[mask].sum() for t, mask in zip(table, group.masks, strict=True)))
            for table in (numbers, squared)
        )
        if redundancy < FEW or adjustment.redundancy - redundancy < FEW:
            continue
        rest = (figures.vtpv - squares) / (adjustment.redundancy - redundancy)
        factor = np.sqrt(squares / redundancy / rest)
        share = chdtrc(redundancy, redundancy * factor**2)
        if min(share, 1 - share) < LEVEL / 20:
            worse = "worse" if factor > 1 else "better"
            sentences.append(
                f"{group.name} fit {worse} than the other observations: {factor:.2f} times their sigmas would agree"
                " with their residuals; estimate variance components, or change these sigmas"
            )
    return sentences[:NAMED]


def _uncontrolled(adjustment: Adjustment) -> list[str]:
    """Rays whose errors nothing shows."""
    assert adjustment.redundancy_numbers is not None
    structure = adjustment.block.structure
    r = np.asarray(adjustment.redundancy_numbers[0])
    rays = np.flatnonzero((r < UNCONTROLLED).all(1))
    if not len(rays):
        return []
    named = "; ".join(
        f"point {structure.point_names[structure.ray_point[ray]]}"
        f" on image {structure.image_names[structure.ray_image[ray]]}"
        for ray in rays[:NAMED]
    )
    more = f" and {len(rays) - NAMED} more" if len(rays) > NAMED else ""
    are = "1 ray is" if len(rays) == 1 else f"{len(rays)} rays are"
    return [
        f"{are} controlled by nothing else (redundancy numbers below {UNCONTROLLED:g}): {named}{more}; a gross error"
        " there stays unseen: measure the points on one more image"
    ]
