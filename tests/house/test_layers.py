"""The layers hold: imports go down only, none hides in a function, none leads back, and a file is one thing."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "jaxbundle"
LAYERS = {
    "numerics": 0,
    "geometry": 1,
    "camera": 2,
    "textbook": 3,
    "block": 3,
    "normals": 4,
    "solve": 5,
    "statistics": 6,
    "orientation": 7,
    "planning": 7,
    "imagery": 7,
    "diagnosis": 8,
    "independent": 8,
    "io": 9,
    "report": 10,
    "measuring": 10,
    "plot": 11,
    "cli": 12,
}
LONGEST = 400  # lines
MAX_POSITIONAL = 5  # arguments


def module_of(path: Path) -> str:
    """Dotted name; a folder's own name for its __init__.py."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# the public interface offers names of all layers and is imported by none
MODULES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py")) if path.parent != PACKAGE}


def imported(module: str) -> Iterator[tuple[str, int]]:
    """Modules of the package that a module imports, with their lines."""
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}, line {node.lineno}: imports name the package"
            submodules = (f"{node.module}.{alias.name}" for alias in node.names)
            names = [name if name in MODULES else node.module or "" for name in submodules]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from ((name, node.lineno) for name in names if name.split(".")[0] == "jaxbundle")


def layer(module: str) -> int:
    return LAYERS[module.split(".")[1]]


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down(module):
    for name, line in imported(module):
        assert name in MODULES, f"line {line}: {name} is no module"
        inside = name.split(".")[1] == module.split(".")[1]
        assert inside or layer(name) < layer(module), f"line {line}: {name} lies above or beside"


def test_solver_knows_no_closed_form():
    for module in MODULES:
        if 3 <= layer(module) <= 5 and not module.startswith("jaxbundle.textbook"):
            assert not [name for name, _ in imported(module) if name.startswith("jaxbundle.textbook")], module


def test_no_import_leads_back():
    graph = {module: {name for name, _ in imported(module)} for module in MODULES}
    done = set()

    def visit(module: str, above: tuple[str, ...]) -> None:
        assert module not in above, " -> ".join((*above, module))
        if module not in done:
            for other in graph[module]:
                visit(other, (*above, module))
            done.add(module)

    for module in graph:
        visit(module, ())


@pytest.mark.parametrize("module", MODULES)
def test_no_import_hides_in_a_function(module):
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            hidden = [inner.lineno for inner in ast.walk(node) if isinstance(inner, ast.Import | ast.ImportFrom)]
            assert not hidden, f"{module}, lines {hidden}"


@pytest.mark.parametrize("folder", ["jaxbundle", "tests", "examples"])
def test_files_are_short(folder):
    length = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / folder).rglob("*.py")}
    assert not {path.name: lines for path, lines in length.items() if lines > LONGEST}


def test_plan_of_the_elimination_is_host_work():
    """numpy only: JAX appears where a plan becomes a problem."""
    for module in (module for module in MODULES if module.startswith("jaxbundle.normals.plan")):
        for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] in ("jax", "equinox")], module


def test_types_of_the_normal_equations_import_no_kernel():
    inside = {name for name, _ in imported("jaxbundle.normals.problem") if name.startswith("jaxbundle.normals")}
    assert all(name.startswith("jaxbundle.normals.plan") for name in inside)


@pytest.mark.parametrize("room", ["normals"])
def test_few_positional_arguments(room):
    for module in (module for module in MODULES if module.split(".")[1] == room):
        for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [a.arg for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")]
                assert len(names) <= MAX_POSITIONAL, f"{module}.{node.name}"


def test_no_import_starts_jax():
    """The number of devices can be chosen after all modules are imported, as the README says."""
    modules = ", ".join(module for module in MODULES if not module.endswith("__main__"))
    code = f"import jax, {modules}; jax.config.update('jax_num_cpu_devices', 3); assert jax.device_count() == 3"
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
