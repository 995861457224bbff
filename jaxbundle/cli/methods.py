"""The methods of `jaxbundle adjust`: bundle, independent models and independent strips, also as start of another."""

from collections.abc import Callable
from typing import NamedTuple

from jaxbundle.block.block import Block
from jaxbundle.independent.model_adjustment import adjust_models
from jaxbundle.independent.polynomials import Form
from jaxbundle.independent.strip_adjustment import adjust_strips
from jaxbundle.report.method_sections import MethodAdjustment
from jaxbundle.solve.adjust import Progress
from jaxbundle.solve.options import Options


class Methods(NamedTuple):
    """The method of the adjustment, the method before it, and the polynomials of strips."""

    method: str = "bundle"
    start: str | None = None
    degree: int = 2
    form: Form = "separate"


def started(block: Block, methods: Methods) -> Block:
    """The block, with the results of another method as approximate values if requested."""
    if methods.start is None:
        return block
    return adjusted_by(methods._replace(method=methods.start), block, Options(precision=False), None).block


def adjusted_by(
    methods: Methods, block: Block, options: Options, progress: Callable[[Progress], None] | None
) -> MethodAdjustment:
    """Adjusts by models or strips."""
    if methods.method == "models":
        return adjust_models(block, options, progress=progress)
    return adjust_strips(block, options, degree=methods.degree, form=methods.form, progress=progress)
