"""The methods of `jaxbundle adjust`: bundle, independent models, independent strips; one as the start of another."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from jaxbundle.block.block import Block
from jaxbundle.independent.adjust_models import adjust_models
from jaxbundle.independent.adjust_strips import adjust_strips
from jaxbundle.independent.polynomials import Form
from jaxbundle.io import write_block_folder
from jaxbundle.report.method_sections import MethodAdjustment
from jaxbundle.solve.adjust import Progress
from jaxbundle.solve.options import Options


class Methods(NamedTuple):
    """Which method adjusts, which one comes before it, and where the adjusted block goes."""

    method: str = "bundle"
    start: str | None = None
    degree: int = 2
    form: Form = "separate"
    adjusted_block: Path | None = None


def started(block: Block, methods: Methods) -> Block:
    """The block, with the results of another method as its start where that is wanted."""
    if methods.start is None:
        return block
    return adjusted_by(methods._replace(method=methods.start), block, Options(precision=False), None).block


def adjusted_by(
    methods: Methods, block: Block, options: Options, progress: Callable[[Progress], None] | None
) -> MethodAdjustment:
    """The adjustment by models or strips."""
    if methods.method == "models":
        return adjust_models(block, options, progress=progress)
    return adjust_strips(block, options, degree=methods.degree, form=methods.form, progress=progress)


def require_folder_for_block(methods: Methods) -> None:
    """Raises FileExistsError where the adjusted block would be written into something that exists."""
    folder = methods.adjusted_block
    if folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists; give a new folder for the adjusted block (--adjusted-block)")


def write_block(methods: Methods, block: Block) -> None:
    """Writes the adjusted block where that is wanted."""
    if methods.adjusted_block is not None:
        write_block_folder(block, methods.adjusted_block)
