"""The code of the pages runs as it stands, beside the block of `jaxbundle new`, and prints what the pages quote.

The blocks of a page share their names and run in order. Blocks marked as thorough compile programs of their own.
"""

import os
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from cases.documents import DOCS, PAGES, README, ROOT, code_blocks, text_of

import jaxbundle as jb
from jaxbundle.cli import pages

pytestmark = pytest.mark.xdist_group("pages")
DOCUMENTS = {"README": README, **PAGES}
QUICK = [n for n, path in DOCUMENTS.items() if any(b.words == ("python",) for b in code_blocks(path))]
THOROUGH = [n for n, path in DOCUMENTS.items() if any(b.words == ("python", "thorough") for b in code_blocks(path))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the block "quarry"."""
    path = tmp_path_factory.mktemp("pages")
    pages.new(path / "quarry")
    return path


@pytest.fixture(autouse=True)
def in_folder(folder, monkeypatch):
    """The pages run where their user is."""
    monkeypatch.chdir(folder)


def run(name: str, *wanted: tuple[str, ...]) -> dict:
    """Runs the blocks of a page with these words; the names that they leave."""
    names: dict = {}
    for number, block in enumerate(code_blocks(DOCUMENTS[name])):
        if block.words in wanted:
            exec(compile(block.text, f"{name}, block {number}", "exec"), names)  # the pages are part of the project
    return names


def test_all_code_is_python_that_is_run_or_marked():
    known = {("python",), ("python", "thorough"), ("text",), ("toml",), ("sh",)}
    for name, path in DOCUMENTS.items():
        assert {block.words for block in code_blocks(path)} <= known, name


@pytest.mark.parametrize("name", QUICK)
def test_code_runs(name, capsys):
    run(name, ("python",))
    printed = capsys.readouterr().out
    if name == "README":
        (expected,) = [b.text for b in code_blocks(README) if b.words == ("text",) and b.text.startswith("converged")]
        assert printed == expected


@pytest.mark.thorough
@pytest.mark.parametrize("name", THOROUGH)
def test_thorough_code_runs(name, capsys):
    """What a page quotes of its output, a block of text behind the code, is printed."""
    run(name, ("python",), ("python", "thorough"))
    printed = " ".join(capsys.readouterr().out.split())
    blocks = code_blocks(DOCUMENTS[name])
    for code, quoted in zip(blocks, blocks[1:], strict=False):
        if code.words[0] == "python" and quoted.words == ("text",):
            assert " ".join(quoted.text.split()) in printed


def test_the_start_page_quotes_the_report(folder):
    """Every block of the page that is part of the report stands in it, line for line."""
    report = jb.report.report_text(jb.adjust(jb.read("quarry"))).splitlines()
    quoted = text_of(PAGES["start"]).partition("## The report, line by line")[2].partition("## The same")[0]
    lines = [line for line in quoted.splitlines() if line.startswith("  ") and "last step" not in line]
    assert len(lines) > 25 and not [line for line in lines if line not in report]


def test_the_picture_is_made_by_its_script(folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["plan"])
    runpy.run_path(str(ROOT / "examples" / "09_plan_of_a_block.py"), run_name="__main__")
    assert "4 images and 8 points" in capsys.readouterr().out
    assert (folder / "plan.svg").read_text(encoding="utf-8") == text_of(DOCS / "quarry.svg")
    os.remove(folder / "plan.svg")


def test_the_minimal_detectable_error_of_the_page_on_statistics(folder):
    tables = jb.statistics.reliability(jb.adjust(jb.read("quarry")))
    assert tables.redundancy_numbers[0].min() == pytest.approx(0.113, abs=5e-4)
    assert np.max(tables.minimal_detectable[0]) == pytest.approx(6.13, abs=5e-3)
