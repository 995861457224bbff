"""The section of the iterations: the effect of each step on v^T P v."""

import numpy as np

from jaxbundle.report.figures import Figures
from jaxbundle.report.section import Chapter, ReportColumn, ReportTable, Section, digits, first, of_page

SHOWN = 30  # maximum number of iterations in the text


def history(figures: Figures) -> Section:
    """A table of all iterations: v^T P v after the step, damping, length of the step, and whether it was accepted."""
    kept = figures.adjustment.iterations.history
    cost, damping, step = (np.asarray(x) for x in (kept.cost, kept.damping, kept.step))
    accepted = np.asarray(kept.accepted)
    rows = np.flatnonzero(~np.isnan(damping))
    cost, damping, step, accepted = 2 * cost[rows], damping[rows], step[rows], accepted[rows]
    columns = (
        ReportColumn("iteration", [str(row + 1) for row in rows], "iteration", place=0, is_name=True),
        ReportColumn("vtPv", cost, "vTPv", lambda value: digits(value, 8), is_result=True),
        ReportColumn("damping", damping, "lambda", lambda value: digits(value, 2), is_result=True),
        ReportColumn("step", step, "|J d| / |v|", lambda value: digits(value, 2), is_result=True),
        ReportColumn("accepted", accepted, is_result=True),
        of_page("", np.where(accepted, "", "rejected")),
    )
    every = np.arange(len(rows))
    shown, more = first(every, SHOWN, "iterations")
    more = more.replace("the tables contain", "report.json contains")
    table = ReportTable("history", columns, shown, more, results=every, in_file=False, rows=every)
    return Section("Iterations", (table,), Chapter.ITERATIONS)
