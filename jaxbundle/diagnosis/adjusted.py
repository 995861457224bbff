"""All findings about an adjustment, in the order of a report."""

import dataclasses

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, in_order, of_kind
from jaxbundle.diagnosis.after_failure import causes
from jaxbundle.diagnosis.boresight import boresight_findings
from jaxbundle.diagnosis.controlled import controlled_findings
from jaxbundle.diagnosis.culprits import findings_of_suspects
from jaxbundle.diagnosis.elements import element_findings
from jaxbundle.diagnosis.flying_heights import flying_height_findings
from jaxbundle.diagnosis.points import point_findings
from jaxbundle.diagnosis.reweighted import robust_findings
from jaxbundle.diagnosis.sigmas import sigma_findings
from jaxbundle.solve.adjustment import Adjustment, Status
from jaxbundle.solve.verdict import BEYOND_USE
from jaxbundle.statistics.suspects import find_suspects

NO_ERRORS = 1e-6  # sigma0 of observations without errors: residuals are rounding errors
CAUSES = (Kind.FORMAT, Kind.INTERIOR, Kind.CONTROL_SYSTEM, Kind.START, Kind.SYSTEMATIC, Kind.SUSPECT)
MISLEADING = (  # sigma0: above this, large residuals also occur at correct observations
    Kind.FORMAT,
    Kind.INTERIOR,
    Kind.CONTROL_SYSTEM,
    Kind.BEHIND,
    Kind.MIRRORED,
    Kind.BELOW_TERRAIN,
    Kind.PARTS,
    Kind.UNDETERMINED,
)


def findings(adjustment: Adjustment, start: Block | None = None) -> tuple[Finding, ...]:
    """Returns the findings about a concrete adjustment.

    Findings that forbid its use come first; causes precede consequences.

    `start`: the block before the adjustment; if given, the causes of a failed convergence are searched for.

    Example:
        >>> [finding.kind.name for finding in jb.findings(result)]
        []
    """
    found = [*adjustment.findings, *robust_findings(adjustment)]
    told = () if of_kind(adjustment.failures, *MISLEADING) else _of_residuals(adjustment)
    if start is not None and not _explain(told):
        told = causes(start, adjustment) or told
    found += told
    if adjustment.status is Status.CONVERGED or _creeps(adjustment):
        found += [*element_findings(adjustment), *flying_height_findings(adjustment)]
    if adjustment.status is Status.CONVERGED:
        found += [*boresight_findings(adjustment), *point_findings(adjustment), *controlled_findings(adjustment)]
    if not adjustment.block.structure.model.photographs:
        what = "gross errors were not searched for: the sensors of this block are not photographs"
        found.append(Finding(Kind.INFORMATION, what, "compare the residuals with their standard deviations"))
    if adjustment.cofactors is None:
        found.append(Finding(Kind.NO_PRECISION, "no standard deviations were computed"))
    return in_order(_explained(found, _creeps(adjustment)))


def _creeps(adjustment: Adjustment) -> bool:
    """Whether an adjustment fits but has not converged: unknowns that are hardly determined still change."""
    fits = float(adjustment.sigma0) <= BEYOND_USE and adjustment.cofactors is not None
    return fits and adjustment.status in (Status.MAXIMUM_ITERATIONS, Status.CREEPING)


def _explain(told: tuple[Finding, ...]) -> bool:
    """Whether the block fits without the suspects; otherwise another cause made their residuals large."""
    fit = [f.size for f in of_kind(told, Kind.GLOBAL_TEST, Kind.SIGMAS)]
    return bool(of_kind(told, Kind.SUSPECT, Kind.SYSTEMATIC)) and max(fit, default=0.0) <= BEYOND_USE


def _explained(found: list[Finding], creeps: bool) -> list[Finding]:
    """If nothing fits and a cause is known, this cause is the problem, and its cure the cure."""
    causes, cure = CAUSES, "first cure the problems above"
    if creeps and not of_kind(found, *CAUSES):
        causes, cure = (Kind.WEAK,), "first cure the weakly determined unknowns below"
    if not of_kind(found, Kind.NOT_CONVERGED, Kind.SIGMA0) or not of_kind(found, *causes):
        return found
    return [
        dataclasses.replace(finding, cure=cure)
        if finding.kind is Kind.NOT_CONVERGED
        else dataclasses.replace(finding, grade=Severity.FAILED)
        if finding.kind in causes
        else finding
        for finding in found
    ]


def _of_residuals(adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about suspects and sigmas; not after a robust adjustment, whose weights reduce residuals."""
    quiet = adjustment.reweighting is not None or float(adjustment.sigma0) < NO_ERRORS
    if quiet or adjustment.status is not Status.CONVERGED:
        return ()
    suspects = find_suspects(adjustment)
    sigmas = sigma_findings(adjustment, suspects.sigma0 if suspects.suspicions else None)
    return (*findings_of_suspects(suspects, float(adjustment.sigma0)), *sigmas)
