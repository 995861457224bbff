"""Trying a user's function with abstract numbers before a solve, without computation or compilation."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

LONGEST = 160  # maximum number of characters of an exception's message


def defect(function: Callable[..., Any], arguments: tuple, count: int) -> str:
    """The problem of a function of scalars that must return `count` scalars and be differentiable; "" if none.

    `arguments`: trees of numbers with arbitrary values.
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
    except Exception as error:  # code of the user: any exception is its error
        return f"fails with {type(error).__name__}: {first_line(error)}"
    return wrong[0]


def first_line(error: BaseException) -> str:
    """The first line of an exception's message, shortened."""
    words = (str(error).strip() or type(error).__name__).splitlines()[0]
    return words if len(words) <= LONGEST else f"{words[: LONGEST - 3]}..."


def _returned_defect(returned: Any, count: int) -> str:
    """The problem of the returned value of a function."""
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
