"""Names of a module that are imported when they are first used, listed in its stub file.

    __getattr__, __dir__, __all__ = lazy_names(__name__, __file__)

The stub, a file with the suffix .pyi, is the only list: type checkers and editors read it, and so does this function.
Each name has a line `from MODULE import NAME as NAME`. A module with the same name as a function of its
package would hide the function after its import; a test forbids that.
"""

import ast
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def lazy_names(module: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a module, from its stub file."""
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body
    lines = [node for node in stub if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: node.module or "" for node in lines for alias in node.names}
    values = [node.target.id for node in stub if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)]

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        if homes[name] == module:  # a module inside this package
            return importlib.import_module(f"{module}.{name}")
        return getattr(importlib.import_module(homes[name]), name)

    return get, lambda: sorted((*homes, *values)), sorted(homes)
