"""The examples in the docstrings of all public names run and show what they say.

They share the block "quarry" of `jaxbundle new` with its adjustment, one small flight and one small image, so that all
together compile little. The names that an example may use are those of `context`.
"""

import ast
import doctest
import importlib
import inspect
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.documents import ROOT
from matplotlib import pyplot
from PIL import Image
from scipy import ndimage

import jaxbundle as jb
from jaxbundle.cli import pages

pytestmark = pytest.mark.xdist_group("pages")
PACKAGE = ROOT / "jaxbundle"
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
# functions that take photographs of a survey: their examples are shown, and tests/imagery and tests/measuring run them
SHOWN = {
    "jaxbundle.imagery.refinement.refine",
    "jaxbundle.imagery.tied.match_tied",
    "jaxbundle.measuring.measurement.measure",
}
# examples that need a package which the tests do not install
NEEDED = {"jaxbundle.report.rerun_file.to_rerun": "rerun"}
# examples that compile programs which no other example needs: several seconds each
MANY_PROGRAMS = (
    "jaxbundle.independent.",
    "jaxbundle.orientation.relative_orientations.",
    "jaxbundle.planning.control_search.",
    "jaxbundle.planning.design_derivatives.",
    "jaxbundle.report.method_report.",
)


def homes() -> Iterator[tuple[str, str]]:
    """Module and name of each public object, from the stubs."""
    for stub in sorted(PACKAGE.rglob("*.pyi")):
        for node in ast.parse(stub.read_text(encoding="utf-8")).body:
            if (
                isinstance(node, ast.ImportFrom)
                and (ROOT / (node.module or "").replace(".", "/")).with_suffix(".py").is_file()
            ):
                yield from ((node.module or "", alias.name) for alias in node.names)


def docstring(module: str, name: str) -> str:
    """The docstring of a public object; of a constant the string behind it."""
    home = importlib.import_module(module)
    value = getattr(home, name)
    if inspect.isroutine(value) or inspect.isclass(value) or hasattr(value, "__wrapped__"):
        return inspect.getdoc(value) or ""
    body = ast.parse(inspect.getsource(home)).body
    for assigned, documented in zip(body, body[1:], strict=False):
        names = assigned.targets if isinstance(assigned, ast.Assign) else []
        if any(isinstance(target, ast.Name) and target.id == name for target in names):
            if isinstance(documented, ast.Expr) and isinstance(documented.value, ast.Constant):
                return inspect.cleandoc(str(documented.value.value))
    return ""


PUBLIC = sorted({f"{module}.{name}" for module, name in homes() if "html" not in module or name != "html_of"})


@pytest.fixture(scope="module")
def context(tmp_path_factory) -> Iterator[dict[str, Any]]:
    """What the examples use."""
    before, folder = Path.cwd(), tmp_path_factory.mktemp("examples")
    os.chdir(folder)
    pages.new(Path("quarry"))
    block = jb.read("quarry")
    corners = jb.planning.ControlSet("corners", sigmas=(0.02, 0.02, 0.03))
    plan = jb.planning.schematic(strips=1, images=3, control=(corners,))
    flight = jb.planning.simulate_flight(plan)
    texture = ndimage.gaussian_filter(np.random.default_rng(1).uniform(0, 255, (35, 35)), 1.5)
    Image.fromarray(texture.astype(np.uint8)).save("photo.png")
    Path("three.txt").write_text(bal_of_three_images(), encoding="utf-8")
    yield {
        **{"jb": jb, "jax": jax, "jnp": jnp, "np": np, "Path": Path},
        **{"block": block, "result": jb.adjust(block), "bal": jb.io.read_bal("three.txt"), "texture": texture},
        **{"plan": plan, "flight": flight, "prediction": jb.planning.predict(flight.truth)},
    }
    os.chdir(before)


def bal_of_three_images() -> str:
    """A BAL file of three images at X = 0, 1, 2, which look along -Z at five points."""
    points = np.array([[0, 0, -5], [1, 0, -6], [0, 1, -5], [1, 1, -6], [0.5, -1, -4]])
    rays = [(k, i, *(-1000 * (p[:2] - [k, 0]) / p[2])) for k in range(3) for i, p in enumerate(points)]
    numbers = [value for k in range(3) for value in (0, 0, 0, -k, 0, 0, 1000, 0, 0)] + points.ravel().tolist()
    lines = [f"3 5 {len(rays)}", *(" ".join(map(str, ray)) for ray in rays), *map(str, numbers)]
    return "\n".join(lines) + "\n"


def test_every_public_name_has_an_example(capsys):
    without = [name for name in PUBLIC if ">>>" not in docstring(*name.rsplit(".", 1))]
    assert not without
    with capsys.disabled():
        print(f"\n{len(PUBLIC)} public names, each with an example; {len(PUBLIC) - len(SHOWN)} examples run")


def run(name: str, context: dict[str, Any]) -> None:
    """Runs the example of a name."""
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    text = docstring(*name.rsplit(".", 1))
    assert "+SKIP" not in text
    test = doctest.DocTestParser().get_doctest(text, dict(context), name, None, 0)
    output: list[str] = []
    failed = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(test, out=output.append).failed
    pyplot.close("all")
    assert not failed, "".join(output)


@pytest.mark.parametrize("name", [n for n in PUBLIC if n not in SHOWN and not n.startswith(MANY_PROGRAMS)])
def test_example(name, context):
    run(name, context)


@pytest.mark.thorough
@pytest.mark.parametrize("name", [n for n in PUBLIC if n not in SHOWN and n.startswith(MANY_PROGRAMS)])
def test_example_with_many_programs(name, context):
    run(name, context)
