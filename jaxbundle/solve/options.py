"""The options of an adjustment: one object for all functions that adjust, stored in the result."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypedDict, get_args

import equinox as eqx

from jaxbundle.normals.plan.reduced_plan import Method
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.solve.implicit import Derivatives
from jaxbundle.solve.stopping_rules import AbstractStoppingRule, AngleRule
from jaxbundle.solve.weight_functions import AbstractWeightFunction

METHODS = ("levenberg-marquardt", "gauss-newton")
ENGINES = ("block", "jaxopt")


def _rule(rule: AbstractStoppingRule | None) -> AbstractStoppingRule:
    return AngleRule() if rule is None else rule


class Choices(TypedDict, total=False):
    """The options as keywords of a function."""

    method: str
    stop: AbstractStoppingRule | None
    max_iterations: int
    precision: bool
    engine: str
    reduced: Method
    devices: int | None
    robust: AbstractWeightFunction | None
    derivatives: Derivatives


class Options(eqx.Module):
    """Options of an adjustment. `dataclasses.replace(options, precision=False)` changes one of them.

    Raises: ValueError for impossible options.

    Example:
        >>> options = jb.Options(max_iterations=30, stop=jb.stopping.AngleRule(1e-6))
        >>> options.max_iterations, options.stop.limit
        (30, 1e-06)
    """

    method: str = eqx.field(static=True, default="levenberg-marquardt")
    """"levenberg-marquardt", damped steps for any start, or "gauss-newton", full steps for a good one."""
    stop: AbstractStoppingRule = eqx.field(converter=_rule, default_factory=AngleRule)
    """The stopping rule; None means AngleRule()."""
    max_iterations: int = eqx.field(static=True, default=200)
    """Maximum number of iterations of one solve."""
    precision: bool = eqx.field(static=True, default=True)
    """Whether cofactors and standard deviations are computed."""
    engine: str = eqx.field(static=True, default="block")
    """"block", or "jaxopt", an independent solver for small blocks."""
    reduced: Method = eqx.field(static=True, default="auto")
    """Solver of the reduced normal equations: "dense", "panels", "pcg", or "auto" by their size."""
    devices: int | None = eqx.field(static=True, default=None)
    """Number of JAX devices; None means all, or one for a small block."""
    robust: AbstractWeightFunction | None = None
    """The weight function of a robust adjustment; None for least squares."""
    derivatives: Derivatives = eqx.field(static=True, default="exact")
    """The derivatives of the minimum: "exact" or "gauss-newton"."""

    def __check_init__(self) -> None:
        prepare_jax()
        if not isinstance(self.stop, AbstractStoppingRule):
            raise TypeError(f"stop takes a stopping rule, such as jb.stopping.AngleRule(), not {self.stop!r}")
        if not isinstance(self.robust, AbstractWeightFunction | None):
            raise TypeError(f"robust takes a weight function, such as jb.robust.Huber(), not {self.robust!r}")
        if self.method not in METHODS or self.engine not in ENGINES:
            raise ValueError(
                f"no method {self.method!r} with engine {self.engine!r}; there are {list(METHODS)} and {list(ENGINES)}"
            )
        if self.precision and self.reduced == "pcg":
            raise ValueError("conjugate gradients give no standard deviations: call adjust(..., precision=False)")
        if self.derivatives not in get_args(Derivatives):
            raise ValueError(f"no derivatives {self.derivatives!r}; there are {list(get_args(Derivatives))}")


def chosen(options: Options | None, choices: Mapping[str, Any], function: str) -> Options:
    """The options with changes; `function`: name of the calling function for messages.

    Raises: TypeError for a name that is not an option; ValueError as `Options`.
    """
    if options is not None and not isinstance(options, Options):
        raise TypeError(f"{function} takes Options, not {type(options).__name__}: call jb.{function}(..., options=...)")
    known = [field.name for field in dataclasses.fields(Options)]
    unknown = [name for name in choices if name not in known]
    if unknown:
        raise TypeError(f"{function} has no option {unknown[0]!r}; there are {', '.join(known)}")
    if options is None:
        return Options(**choices)
    return dataclasses.replace(options, **choices) if choices else options
