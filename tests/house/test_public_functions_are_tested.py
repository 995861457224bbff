"""Each public function is used by a default test, not only by thorough ones and by the example of its docstring."""

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PACKAGE = TESTS.parent / "jaxbundle"
NOT_DEFAULT = "benchmarks", "house", "docs"  # folders: scripts, and tests of the names themselves


def public_functions() -> set[str]:
    """The functions that the stubs of the top level and of the namespaces name."""
    found = set()
    for stub in PACKAGE.rglob("*.pyi"):
        for node in ast.parse(stub.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(node.module or "")
                found |= {alias.name for alias in node.names if inspect.isroutine(getattr(module, alias.name))}
    return found


def is_thorough(node: ast.AST) -> bool:
    """Whether a test or the marks of a module are those of the thorough tests."""
    marks = node.decorator_list if isinstance(node, ast.FunctionDef) else [node]
    return any(isinstance(part, ast.Attribute) and part.attr == "thorough" for mark in marks for part in ast.walk(mark))


def default_code(path: Path) -> Iterator[ast.stmt]:
    """The statements of a test module without thorough tests and imports."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    marks = [node for node in body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"]
    if not any(is_thorough(node) for node in marks):
        for node in body:
            imports = isinstance(node, ast.Import | ast.ImportFrom)
            if not imports and not (isinstance(node, ast.FunctionDef) and is_thorough(node)):
                yield node


@pytest.fixture(scope="module")
def used() -> set[str]:
    """All names in the code of default tests and of the cases they share."""
    paths = [path for path in TESTS.rglob("*.py") if path.relative_to(TESTS).parts[0] not in NOT_DEFAULT]
    nodes = [node for path in paths for statement in default_code(path) for node in ast.walk(statement)]
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


def test_each_public_function_has_a_default_test(used):
    assert not sorted(public_functions() - used)
