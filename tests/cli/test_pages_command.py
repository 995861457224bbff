"""`jaxbundle docs`, `jaxbundle new` and the help: everything that needs no JAX."""

import sys

import pytest
from cases.documents import PAGES, text_of
from rich.console import Console

from jaxbundle.cli import main, pages


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a command line in an empty folder; exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["jaxbundle", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


def test_docs_shows_the_index(run):
    assert run("docs") == (0, text_of(PAGES["index"]), "")


def test_docs_shows_a_page(run):
    assert run("docs", "glossary") == (0, text_of(PAGES["glossary"]), "")


def test_docs_is_rendered_in_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(pages, "Console", lambda: Console(force_terminal=True, width=80))
    pages.show("index")
    out = capsys.readouterr().out
    assert "\x1b[" in out and "[start](start.md)" not in out and "Reference" in out


def test_an_unknown_page_is_told_with_the_list(run):
    code, out, err = run("docs", "strat")
    assert (code, out) == (2, "") and "there is no page 'strat'" in err
    assert all(name in err for name in PAGES)


def test_names_of_pages_are_completed():
    assert pages.completed("how-to-r") == ["how-to-robust"] and pages.page_names()[0] == "index"


def test_new_writes_the_template(run, tmp_path):
    code, out, _ = run("new", "quarry")
    assert code == 0 and "jaxbundle adjust quarry" in out
    written = {path.name: path.read_bytes() for path in (tmp_path / "quarry").iterdir()}
    assert written == {path.name: path.read_bytes() for path in pages.TEMPLATE.iterdir()}


@pytest.mark.parametrize("what", ["a full folder", "a file"])
def test_new_overwrites_nothing(run, tmp_path, what):
    path = tmp_path / "quarry"
    if what == "a file":
        path.write_text("mine")
    else:
        path.mkdir()
        (path / "mine.txt").write_text("mine")
    code, out, err = run("new", "quarry")
    assert (code, out) == (2, "") and "give the name of a new" in err
    assert path.is_file() or [file.name for file in path.iterdir()] == ["mine.txt"]


def test_new_takes_an_empty_folder(run, tmp_path):
    (tmp_path / "quarry").mkdir()
    assert run("new", "quarry")[0] == 0


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_version(run, option):
    assert run(option) == (0, "jaxbundle 0.1.0\n", "")


def test_help_has_panels_the_everyday_options_first(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    code, out, _ = run("adjust", "-h")
    everyday = "--out", "--robust", "─ Method", "--method", "─ Solver", "--stop", "─ Cluster", "--coordinator"
    places = [out.index(words) for words in everyday]
    assert code == 0 and places == sorted(places)


def test_commands_have_panels(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    out = run("-h")[1]
    assert all(words in out for words in ("─ Adjust", "─ Learn and start", "docs", "new", "convert"))
