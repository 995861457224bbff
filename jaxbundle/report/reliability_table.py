"""Reliability of the observations by groups: what a report shows of it, as text and as numbers."""

from typing import Any

import numpy as np

from jaxbundle.report.columns import aligned
from jaxbundle.report.figures import Figures
from jaxbundle.statistics.reliability import UNCONTROLLED, reliability
from jaxbundle.statistics.subsets import three_groups


def reliability_of_groups(figures: Figures) -> dict[str, dict[str, Any]]:
    """By group: number, sum, mean and smallest of the redundancy numbers, uncontrolled ones, largest |w| and MDE."""
    adjustment = figures.adjustment
    if adjustment.redundancy_numbers is None or adjustment.undetermined:
        return {}
    found, groups = reliability(adjustment), {}
    for group in three_groups(adjustment.block):
        r, w, mde = (
            np.concatenate([table[mask] for table, mask in zip(tables, group.masks, strict=True)])
            for tables in (found.redundancy_numbers, found.w, found.minimal_detectable)
        )
        controlled = r > UNCONTROLLED
        groups[group.name] = {
            "observations": len(r),
            "redundancy": float(r.sum()),
            "mean": float(r.mean()),
            "smallest": float(r.min()),
            "uncontrolled": int((~controlled).sum()),
            "largest_w": float(np.nanmax(np.abs(w), initial=0.0)) / max(figures.sigma0, np.finfo(float).tiny),
            "largest_mde": float(mde.max(initial=0.0)),
        }
    return groups


def reliability_lines(figures: Figures) -> list[str]:
    """The same as lines of text."""
    rows = [
        (
            name,
            f"{g['observations']}",
            f"{g['redundancy']:.2f}",
            f"{g['mean']:.3f}",
            f"{g['smallest']:.3f}",
            f"{g['uncontrolled']}",
            f"{g['largest_w']:.2f}",
            f"{g['largest_mde']:.4g}",
        )
        for name, g in reliability_of_groups(figures).items()
    ]
    header = ("group", "number", "sum r", "mean r", "least r", "r < 0.04", "largest |w|/sigma0", "largest MDE")
    return aligned([header, *rows]) if rows else []
