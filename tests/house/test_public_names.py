"""The public names: what the top level and each namespace offer, loaded when used, listed once, hidden by no module."""

import ast
import importlib
import subprocess
import sys
from collections import Counter, defaultdict
from operator import attrgetter
from pathlib import Path

import pytest

import jaxbundle as jb

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "jaxbundle"
EVERY_DAY = """Adjustment Block BlockError Options Status adjust adjust_many approximate collinearity covariance_of
export findings read simulate snoop write_block_folder write_report""".split()
NAMESPACES = """blocks cameras imagery independent io measuring observations orientation planning plot report results
robust statistics stopping textbook""".split()
STUBS = sorted(PACKAGE.rglob("*.pyi"))


def lines(stub: Path) -> list[ast.ImportFrom]:
    """The imports of a stub, which is nothing else."""
    body = ast.parse(stub.read_text(encoding="utf-8")).body
    return [node for node in body if isinstance(node, ast.ImportFrom)]


def module_of(stub: Path) -> str:
    """Dotted name of the module that a stub belongs to."""
    parts = stub.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_the_top_level_holds_the_names_of_every_day_and_the_namespaces():
    names: dict = {}
    exec("from jaxbundle import *", names)
    assert names.keys() - {"__builtins__"} == {*EVERY_DAY, *NAMESPACES}
    assert dir(jb) == sorted((*EVERY_DAY, *NAMESPACES, "__version__"))


@pytest.mark.parametrize("name", NAMESPACES)
def test_a_namespace_lists_and_loads_its_names(name):
    module = getattr(jb, name)
    assert module is importlib.import_module(f"jaxbundle.{name}")
    assert module.__doc__ and dir(module) == sorted(module.__all__) and len(set(module.__all__)) == len(module.__all__)
    for public in module.__all__:
        assert getattr(module, public) is not None
    with pytest.raises(AttributeError, match=f"module 'jaxbundle.{name}' has no attribute 'no_name'"):
        attrgetter("no_name")(module)


def test_names_of_every_day_stand_in_their_namespace():
    everywhere = {name: getattr(jb, space) for space in NAMESPACES for name in getattr(jb, space).__all__}
    missing = [name for name in EVERY_DAY if name not in everywhere]
    assert sorted(missing) == ["Options", "adjust", "adjust_many", "findings"]


@pytest.mark.parametrize("stub", STUBS, ids=module_of)
def test_a_stub_says_where_each_name_stands(stub):
    """And a package's stub names no layer above it: the public interface only does."""
    for node in lines(stub):
        assert node.level == 0 and all(alias.asname == alias.name for alias in node.names)
    for node in lines(stub):
        assert {alias.name for alias in node.names} <= set(vars(importlib.import_module(node.module or ""))) or (
            node.module == module_of(stub)
        )


@pytest.mark.parametrize("stub", [stub for stub in STUBS if stub.stem == "__init__"], ids=module_of)
def test_no_module_hides_a_public_name(stub):
    """An import of the module `a.b` sets `b` in the package `a`, and would hide a function of that name."""
    inside = {path.stem for path in stub.parent.iterdir() if path.suffix == ".py" or path.is_dir()}
    names = {alias.name for node in lines(stub) if node.module != module_of(stub) for alias in node.names}
    assert not sorted(inside & names)


def test_a_module_name_occurs_once():
    places = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        if path.stem != "__init__":
            places[path.stem].append(str(path.relative_to(PACKAGE)))
    assert not {name: paths for name, paths in places.items() if len(paths) > 1}


def test_a_test_file_has_its_own_name():
    """pytest imports a test file by its name alone: of two with one name, the second is an error of the whole run."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert not [name for name, count in names.items() if count > 1]


def test_import_loads_nothing_heavy():
    heavy = "jax", "numpy", "scipy", "equinox", "optimistix", "polars", "pydantic", "matplotlib", "cv2"
    code = f"import sys, jaxbundle as jb; dir(jb); print(jb.__version__, [m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{jb.__version__} []"
