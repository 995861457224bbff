"""Findings from the redundancy: uncontrolled observations, points on two images, too small total redundancy."""

import numpy as np
from jaxtyping import Bool

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.block.wording import are, counted, figure, named
from jaxbundle.diagnosis.rays_in_words import ray_name, ray_subject
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.reliability_tables import UNCONTROLLED, reliability
from jaxbundle.statistics.snooping import describe

FEW_RAYS = 8  # rays of an image: twice the number for its six unknowns, and a margin of one point
SMALL_REDUNDANCY = 10  # below this sigma0, and all standard deviations with it, are uncertain by more than 22 %
NOTHING = 1e-6  # redundancy number of an observation that is necessary to determine an unknown


def controlled_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about small redundancy, uncontrolled rays and other observations, and points on two images."""
    found = [*_redundancy(adjustment)]
    if adjustment.redundancy_numbers is not None and not adjustment.undetermined:
        found += [*_rays(adjustment), *_others(adjustment)]
    return (*found, *_seen_twice(adjustment))


def _redundancy(adjustment: Adjustment) -> list[Finding]:
    """The finding about a small redundancy r: the relative variance of sigma0^2 is 2 / r, of sigma0 1 / (2 r)."""
    r = adjustment.redundancy
    if r >= SMALL_REDUNDANCY:
        return []
    share = 1 / np.sqrt(2 * r)
    what = f"the redundancy is {r}: sigma0 and all standard deviations are uncertain by {share:.0%}"
    return [Finding(Kind.REDUNDANCY, what, "measure more, or judge precision by the cofactors and sigma0 = 1", size=r)]


def _rays(adjustment: Adjustment) -> list[Finding]:
    """Findings about uncontrolled rays, separate for points on two images and for images with few rays."""
    assert adjustment.redundancy_numbers is not None
    structure = adjustment.block.structure
    rays = np.flatnonzero((np.asarray(adjustment.redundancy_numbers[0]) < UNCONTROLLED).all(1))
    of_image = np.bincount(structure.ray_image)[structure.ray_image[rays]]
    weak_image = of_image < FEW_RAYS
    found = []
    for mask, cure in (
        (~weak_image, "measure these points on one more image"),
        (weak_image, "measure more points on these images"),
    ):
        chosen = rays[mask]
        if len(chosen):
            listed = named([ray_name(structure, ray) for ray in chosen.tolist()])
            what = (
                f"{counted(len(chosen), 'ray')} {are(len(chosen))} (almost) without redundancy (numbers below"
                f" {UNCONTROLLED:g}), so a gross error would stay unnoticed: {listed}"
            )
            subjects = tuple(ray_subject(structure, ray) for ray in chosen.tolist())
            found.append(Finding(Kind.UNCONTROLLED, what, cure, subjects, len(chosen)))
    return found


def _others(adjustment: Adjustment) -> list[Finding]:
    """Findings about uncontrolled members of each kind of observation, with the minimum detectable error."""
    tables, found = reliability(adjustment), []
    for k, group in enumerate(adjustment.block.groups, 1):
        r, observed = tables.redundancy_numbers[k], group.structure.observed
        loose = observed & (r < UNCONTROLLED)
        if loose.any():
            found.append(_uncontrolled_group(adjustment, k, loose))
    return found


def _uncontrolled_group(adjustment: Adjustment, k: int, loose: Bool[np.ndarray, "member component"]) -> Finding:
    """One finding for a kind; its severity is higher where nothing at all controls an observation."""
    tables = reliability(adjustment)
    r, mde = tables.redundancy_numbers[k][loose], tables.minimal_detectable[k][loose]
    places = np.argwhere(loose).tolist()
    described = [describe(adjustment.block, k, row, component) for row, component in places]
    table, several = described[0][1], len(adjustment.block.groups[k - 1].structure.kind.components) > 1
    subjects = tuple(Subject(table, names, what if several else "") for names, _, what in described)
    listed = named([" - ".join(s.names) + (f" {s.component}" if s.component else "") for s in subjects])
    what = f"{counted(len(places), 'observation')} of {table.replace('_', ' ')} {are(len(places))}"
    if r.min() < NOTHING:
        alone = f"{what} without redundancy, an error of any size would stay unnoticed: {listed}"
        return Finding(Kind.UNCONTROLLED, alone, "add observations that check them", subjects, np.inf)
    what += f" hardly controlled (redundancy numbers {figure(r.min(), 2)} to {figure(r.max(), 2)}): {listed}"
    return Finding(Kind.UNCONTROLLED, what, "", subjects, float(mde.max()), grade=Severity.NOTE)


def _seen_twice(adjustment: Adjustment) -> list[Finding]:
    structure = adjustment.block.structure
    rays = np.bincount(structure.ray_point, minlength=len(structure.point_names))[structure.point_free.any(1)]
    twice = int((rays == 2).sum())
    if 2 * twice <= len(rays) or len(structure.image_names) < 3:
        return []
    what = (
        f"{twice} of {len(rays)} points are on two images only: an error along the base moves such a point and leaves"
        " no residuals"
    )
    return [Finding(Kind.TWO_RAYS, what, "measure more points on three images", size=twice)]
