"""The results of independent models or strips as a folder: report.txt, report.json and CSV tables."""

from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, in_order
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io.tables import write_table
from jaxbundle.report.data import dict_of, json_text
from jaxbundle.report.figures import figures_of
from jaxbundle.report.files import columns_of, report_size, tables_of
from jaxbundle.report.group_tables import table_names
from jaxbundle.report.method_sections import MethodAdjustment, method_sections
from jaxbundle.report.result_folder import DATA, TEXT, replaced, require_writable
from jaxbundle.report.text import text_of

OWN_TABLES = {"models": ("models", "model_points"), "strips": ("strips", "coefficients", "corrected_points")}
EVERY_TABLE = ("images", "points", "check_points")
# findings about rays of photographs: a point in one model only is not weak here, coefficients of curves may be 0
OF_PHOTOGRAPHS = (Kind.WEAK, Kind.CORRELATED, Kind.INSIGNIFICANT, Kind.UNCONTROLLED, Kind.TWO_RAYS)


def method_findings(result: MethodAdjustment) -> tuple[Finding, ...]:
    """Findings of the method, points that it left out, and findings of its adjustment."""
    told = [finding for finding in findings(result.adjustment) if finding.kind not in OF_PHOTOGRAPHS]
    return in_order((*result.findings, *told))


def write_method_report(result: MethodAdjustment, folder: str | Path, found: tuple[Finding, ...] | None = None) -> Path:
    """Writes all results of `adjust_models` or `adjust_strips` into a folder and returns its path.

    The tables of images, points, control and check points have the columns of a report of the bundle.

    Raises: OSError where the folder cannot be written.

    Example:
        >>> folder = jb.report.write_method_report(jb.independent.adjust_models(block), "models")
        >>> folder.is_dir()
        True
    """
    target = Path(folder)
    with np.errstate(all="ignore"):  # overflows and unknown values are empty in the tables
        figures = figures_of(result.adjustment, method_findings(result) if found is None else found)
        precision = result.propagated() if result.adjustment.cofactors is not None else None
        sections = [section() for section in method_sections(result, figures, precision)]
        tables = [table for section in sections for table in tables_of(section)]
        names = [*(f"{table.name}.csv" for table in tables), DATA, TEXT]
        with replaced(target, names) as place:
            for table in tables:
                write_table(place / f"{table.name}.csv", columns_of(table))
            (place / DATA).write_text(json_text({**dict_of(figures, sections), "files": names}), encoding="utf-8")
            (place / TEXT).write_text(text_of(figures, sections), encoding="utf-8")
    return target


def require_place_of_method(folder: str | Path, block: Block, method: str) -> None:
    """Checks before the adjustment that a report can be written: writes a file, and checks the free space.

    Raises: OSError in one sentence with the path and the cure.
    """
    names = [f"{name}.csv" for name in (*EVERY_TABLE, *OWN_TABLES[method], *table_names(block))]
    require_writable(Path(folder), [*names, DATA, TEXT], report_size(block))
