"""The pages are complete, linked, and agree with the program."""

import ast
import re
import tomllib
from operator import attrgetter

import pytest
from cases.documents import DOCS, PAGES, README, ROOT, code_blocks, links, text_of

import jaxbundle as jb
from jaxbundle.block.findings import Kind
from jaxbundle.camera.camera_models import CAMERA_MODELS
from jaxbundle.cli.codes import Code
from jaxbundle.cli.pages import TEMPLATE
from jaxbundle.io.block_tables import TABLES

DOCUMENTS = {"README": README, **PAGES}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_resolve(name):
    path = DOCUMENTS[name]
    local = [link for link in links(path) if not link.startswith("http")]
    assert not [link for link in local if not (path.parent / link).is_file()]


def test_every_page_is_linked_from_the_index():
    linked = [link.removesuffix(".md") for link in links(PAGES["index"])]
    assert sorted(linked) == sorted(set(PAGES) - {"index"})


def test_readme_is_short():
    assert len(text_of(README).splitlines()) <= 120


def test_readme_shows_ten_lines_of_python():
    (block,) = [block for block in code_blocks(README) if block.words == ("python",)]
    assert len([line for line in block.text.splitlines() if line]) <= 10


@pytest.mark.parametrize("name", DOCUMENTS)
def test_files_that_a_page_names_exist(name):
    text = text_of(DOCUMENTS[name])
    for file in re.findall(r"`((?:examples|tests)/[\w./]+\.py)`", text):
        assert (ROOT / file).is_file(), file
    for file in re.findall(r"`([a-z]+/[\w./]+\.py)`", text):
        assert (ROOT / file).is_file() or (ROOT / "jaxbundle" / file).is_file(), file


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_an_example_says_what_it_makes(path):
    header = ast.get_docstring(ast.parse(text_of(path))) or ""
    assert re.search(r"^Prints .*table|picture", header, re.MULTILINE), header


@pytest.mark.parametrize("name", DOCUMENTS)
def test_names_of_the_interface_exist(name):
    for public in set(re.findall(r"\bjb\.([A-Za-z]\w*(?:\.[A-Za-z]\w*)?)", text_of(DOCUMENTS[name]))):
        assert attrgetter(public)(jb) is not None


def test_functions_by_purpose_exist():
    table = text_of(PAGES["python"]).partition("## Functions by purpose")[2]
    names = re.findall(r"`([A-Za-z_.]+)`", table.partition("`dir(jb)`")[0])
    assert len(names) > 30 and None not in [attrgetter(name)(jb) for name in names]


def test_kinds_of_findings_are_those_of_the_program():
    text = text_of(PAGES["findings"])
    assert "\n".join(f"| {kind.name} | {kind.title} | {kind.severity.label} |" for kind in Kind) in text


def test_exit_codes_are_those_of_the_program():
    text = text_of(PAGES["command-line"])
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", text, re.MULTILINE)] == list(Code)


def test_camera_models_are_those_of_the_program():
    text = text_of(PAGES["block-folder"])
    assert not [name for name in CAMERA_MODELS if f"| {name} |" not in text]


def test_the_start_page_shows_the_template():
    """Its tables are those that `jaxbundle new` writes, its block.toml the same without comments."""
    blocks = code_blocks(PAGES["start"])
    text = [block.text for block in blocks if block.words == ("text",)]
    for kind in ("images", "control", "rays"):
        assert (TEMPLATE / TABLES[kind].file).read_text(encoding="utf-8") in text, kind
    (shown,) = [block.text for block in blocks if block.words == ("toml",)]
    assert tomllib.loads(shown) == tomllib.loads((TEMPLATE / "block.toml").read_text(encoding="utf-8"))


def test_the_pages_are_package_data():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = settings["tool"]["setuptools"]["package-data"]["jaxbundle"]
    packed = {path for pattern in patterns for path in (ROOT / "jaxbundle").glob(pattern)}
    assert {path for path in DOCS.rglob("*") if path.is_file()} <= packed
