"""The report as nested dictionaries of numbers, names, lists and None, ready for JSON.

A value with its a-posteriori standard deviation is a list [value, standard deviation], in the object unit or
angle unit of the block; a standard deviation of 0 means fixed, None means unknown.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxbundle.block.given import require_a
from jaxbundle.report.figures import Figures, figures_of
from jaxbundle.report.made import made_section
from jaxbundle.report.section import Facts, Picked, ReportColumn, ReportTable, Section
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjustment import Adjustment


def report_dict(adjustment: Adjustment) -> dict[str, Any]:
    """The report of a concrete adjustment as a dictionary: counts, sigma0, unknowns with standard deviations.

    Example:
        >>> isinstance(jb.report.report_dict(result), dict)
        True
    """
    require_a(Adjustment, adjustment, "report.report_dict")
    figures = figures_of(adjustment)
    return dict_of(figures, [*(section() for section in sections_of(figures)), made_section(figures)])


def dict_of(figures: Figures, sections: Sequence[Section]) -> dict[str, Any]:
    """The facts and the results of sections."""
    structure = figures.structure
    units = {"object": structure.object_unit, "angle": structure.angle_unit}
    report: dict[str, Any] = {"kind": "block", "name": structure.name, "units": units}
    for part in (part for section in sections for part in section.parts):
        if isinstance(part, Facts):
            for fact in part.facts:
                report |= finite(fact.entries)
        elif isinstance(part, ReportTable) and part.results is not None:
            report[part.name] = _entries(part, part.results)
    return report


def _entries(table: ReportTable, rows: np.ndarray) -> dict[str, Any]:
    """The results of a table by row names: {column: value}, or just the value for rows with two names."""
    names = [_taken(column, rows) for column in table.columns if column.is_name and column.in_file]
    deviations = {column.deviation_of: column for column in table.columns if column.deviation_of}
    columns = {}
    for column in (column for column in table.columns if column.is_result):
        deviation = deviations.get(column.name)
        parts = [np.asarray(part.values)[rows] for part in (column, deviation) if part]
        columns[column.name] = finite(np.stack(parts, -1) if deviation else parts[0])
    values = zip(*columns.values(), strict=True)
    if len(names) == 1:
        return {name: dict(zip(columns, row, strict=True)) for name, row in zip(*names, values, strict=True)}
    nested: dict[str, Any] = {}
    for outer, inner, (value,) in zip(*names, values, strict=True):
        nested.setdefault(outer, {})[inner] = value
    return nested


def _taken(column: ReportColumn, rows: np.ndarray) -> list[str]:
    values = column.values
    picked = [values.names[k] for k in values.index[rows].tolist()] if isinstance(values, Picked) else None
    return [str(values[k]) for k in rows.tolist()] if picked is None else picked


def finite(value: Any) -> Any:
    """Converts nested data to types of JSON; None replaces numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        plain, known = value.astype(object), np.isfinite(value)
        plain[~known] = None
        return value.tolist() if known.all() else plain.tolist()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return finite(value.item())
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(report: dict[str, Any]) -> str:
    """JSON with one line for each image, point and camera."""
    dumped = json.JSONEncoder(allow_nan=False).encode  # json.dumps would make a new encoder for each line
    entries = []
    for key, value in report.items():
        if isinstance(value, dict) and any(isinstance(item, dict) for item in value.values()):
            lines = ",\n".join(f"  {dumped(name)}: {dumped(item)}" for name, item in value.items())
            entries.append(f" {dumped(key)}: {{\n{lines}\n }}")
        else:
            entries.append(f" {dumped(key)}: {dumped(value)}")
    return "{\n" + ",\n".join(entries) + "\n}\n"
