"""The layers hold: imports go down only, none hides in a function, and a file is one thing."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jaxbundle"
LAYERS = {
    "numerics": 0,
    "geometry": 1,
    "camera": 2,
    "textbook": 3,
    "block": 3,
    "normals": 4,
    "solve": 5,
    "approximate": 7,
    "planning": 7,
    "io": 8,
    "report": 9,
    "cli": 10,
}
FILES = sorted(PACKAGE.rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Modules of the package that a tree imports, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports name the package"
            names = [node.module or ""]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            if name.split(".")[0] == "jaxbundle":
                yield name, node.lineno


def test_every_folder_has_a_layer() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert folders == set(LAYERS)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_down(path: Path) -> None:
    folder = path.parent.name
    if folder == "jaxbundle":
        return  # the public interface offers what all layers have
    for name, line in imported(ast.parse(path.read_text())):
        parts = name.split(".")
        assert len(parts) > 1, f"{path.name}:{line} imports the whole package"
        other = parts[1]
        below = LAYERS[other] < LAYERS[folder] or other == folder
        assert below, f"{path.relative_to(PACKAGE)}:{line} imports {name}, which lies above or beside it"


def test_the_solver_knows_no_closed_form() -> None:
    for path in FILES:
        if path.parent.name in ("block", "normals", "solve"):
            assert "textbook" not in {name.split(".")[1] for name, _ in imported(ast.parse(path.read_text()))}


def test_no_cycles() -> None:
    graph = {
        "jaxbundle." + ".".join(path.relative_to(PACKAGE).with_suffix("").parts): {
            name for name, _ in imported(ast.parse(path.read_text()))
        }
        for path in FILES
    }
    done: set[str] = set()

    def visit(module: str, above: tuple[str, ...]) -> None:
        assert module not in above, " -> ".join((*above, module))
        if module in done or module not in graph:
            return
        for other in graph[module]:
            visit(other, (*above, module))
        done.add(module)

    for module in graph:
        visit(module, ())


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_import_inside_a_function(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            inner = [n for n in ast.walk(node) if isinstance(n, ast.Import | ast.ImportFrom)]
            assert not inner, f"{path.name}:{inner[0].lineno}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_file_is_one_thing(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400
