"""A user's function is tried with abstract numbers before anything is solved: nothing is computed or compiled."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

LONGEST = 160  # characters of an error's own words


def defect(function: Callable[..., Any], arguments: tuple, count: int) -> str:
    """What is wrong with a function of scalars that must return `count` scalars and be differentiable; "" if nothing.

    `arguments`: trees of numbers, of which the values do not matter.
    """
    abstract = jax.tree.map(lambda _: jax.ShapeDtypeStruct((), jnp.result_type(float)), arguments)

    wrong: list[str] = []

    def tried(*given: Any) -> None:
        wrong.append(_returned_defect(function(*given), count))

    def forward(*given: Any) -> Any:
        return jax.jvp(lambda *x: tuple(function(*x)), given, given)[1]

    try:
        jax.eval_shape(tried, *abstract)
        if not wrong[0]:
            jax.eval_shape(forward, *abstract)
    except Exception as error:  # it is anybody's code: whatever it raises is what is wrong with it
        return f"fails with {type(error).__name__}: {first_line(error)}"
    return wrong[0]


def first_line(error: BaseException) -> str:
    """The beginning of an error's words."""
    words = (str(error).strip() or type(error).__name__).splitlines()[0]
    return words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."


def _returned_defect(returned: Any, count: int) -> str:
    """What is wrong with what a function returned."""
    if not isinstance(returned, tuple | list):
        what = f"an array of shape {returned.shape}" if hasattr(returned, "shape") else type(returned).__name__
        return f"returns {what}, not {count} residuals in a tuple"
    if len(returned) != count:
        return f"returns {len(returned)} values, not {count} residuals"
    value: Any
    for value in returned:
        if type(value) in (float, int):
            continue
        if not hasattr(value, "shape") or not hasattr(value, "dtype"):
            return f"returns {type(value).__name__} among its residuals, not numbers"
        if value.shape != ():
            return f"returns a residual of shape {value.shape} for scalars, not a scalar"
        if not jnp.issubdtype(value.dtype, jnp.floating):
            return f"returns a residual of type {value.dtype}, not a floating-point number"
    return ""
