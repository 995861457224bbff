"""The import of this module lets beartype check all arguments and results of the package, with shapes by jaxtyping.

It must come before the first import of the package. A function is decorated at its first call: most functions of the
package are not called in a process.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

import jaxtyping
from beartype import BeartypeConf, FrozenDict, beartype

CONF = BeartypeConf(
    is_pep484_tower=True,  # an int is also a float
    hint_overrides=FrozenDict({Self: Any}),  # beartype sees functions, not the classes that they belong to
)


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with checks of its arguments and its result."""
    decorated: list[Callable[..., Any]] = []

    def on_call(*args: Any, **kwargs: Any) -> Any:
        if not decorated:
            decorated.append(beartype(conf=CONF)(function))
        return decorated[0](*args, **kwargs)

    return on_call


@contextmanager
def unchecked() -> Iterator[None]:
    """Without checks, for what passes wrong types on purpose."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


jaxtyping.install_import_hook("jaxbundle", f"{__name__}.{checked.__name__}")
