"""Conversion of the tables of a report to polars frames."""

import numpy as np
import polars as pl

from jaxbundle.block.given import require_photographs
from jaxbundle.numerics.host import is_concrete
from jaxbundle.report.figures import figures_of
from jaxbundle.report.files import columns_of, tables_of
from jaxbundle.report.sections import sections_of
from jaxbundle.solve.adjustment import Adjustment


def frames_of(adjustment: Adjustment, *, units: bool = True) -> dict[str, pl.DataFrame]:
    """All tables of an adjustment by name; `units`: whether names of columns contain units."""
    if not is_concrete(adjustment):
        raise ValueError("tables are made of numbers: call to_frames outside jit, grad and vmap")
    require_photographs(adjustment.block, "to_frames")
    with np.errstate(all="ignore"):  # overflows and unknown values are null in the tables
        sections = [section() for section in sections_of(figures_of(adjustment, ()))]
    frames = {}
    for table in (table for section in sections for table in tables_of(section)):
        columns = columns_of(table)
        heads = {column.name: column.head or column.name for column in table.columns if column.in_file}
        frame = pl.DataFrame(columns).with_columns(pl.selectors.float().fill_nan(None))
        frames[table.name] = frame.rename(heads) if units else frame
    return frames
