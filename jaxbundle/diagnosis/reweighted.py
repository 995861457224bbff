"""Findings about robust weights: rays that lost their weight, and weights that did not converge."""

import numpy as np

from jaxbundle.block.findings import Finding, Kind
from jaxbundle.block.wording import counted, named
from jaxbundle.diagnosis.rays_in_words import ray_name, ray_subject
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment


def robust_findings(adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about the robust weights of an adjustment; none for least squares."""
    robust, structure = adjustment.reweighting, adjustment.block.structure
    if robust is None:
        return ()
    found, weights = [], np.asarray(robust.weights)
    low = np.flatnonzero(weights < DOWN_WEIGHTED)
    low = low[np.argsort(weights[low], kind="stable")]
    if len(low):
        listed = named([f"{ray_name(structure, ray)} ({weights[ray]:.2g})" for ray in low.tolist()])
        have = "has" if len(low) == 1 else "have"
        what = f"{counted(len(low), 'ray')} {have} a robust weight below {DOWN_WEIGHTED:g}: {listed}"
        cure = "re-measure them or remove those with gross errors, and adjust by least squares"
        subjects = tuple(ray_subject(structure, ray) for ray in low.tolist())
        found.append(Finding(Kind.DOWN_WEIGHTED, what, cure, subjects, len(low)))
    if not robust.settled:
        what = f"the robust weights were still changing after {robust.rounds} rounds"
        found.append(Finding(Kind.UNSETTLED, what, "take another weight function or a larger limit"))
    return tuple(found)
