"""The commands `jaxbundle docs` and `jaxbundle new`: pages of the documentation, and a template block folder."""

from pathlib import Path

import typer
from rich.console import Console
from rich.markdown import Markdown

from jaxbundle.block.problems import shown
from jaxbundle.cli.codes import BadInput

PAGES = Path(__file__).parents[1] / "docs"
TEMPLATE = PAGES / "template"
INDEX = "index"


def page_names() -> list[str]:
    """Names of all pages, the index first."""
    names = sorted(path.stem for path in PAGES.glob("*.md"))
    return sorted(names, key=lambda name: name != INDEX)


def completed(incomplete: str) -> list[str]:
    """The pages whose names begin with a text."""
    return [name for name in page_names() if name.startswith(incomplete)]


def page(name: str) -> str:
    """The Markdown text of a page.

    Raises:
        BadInput: for a page that does not exist; the message lists all pages.
    """
    if name not in page_names():
        raise BadInput(f"there is no page {shown(name)!r}; the pages are {', '.join(page_names())}")
    return (PAGES / f"{name}.md").read_text(encoding="utf-8")


def show(name: str) -> None:
    """Shows a page: rendered in a terminal, as plain Markdown in a pipe."""
    text, console = page(name), Console()
    if console.is_terminal:
        console.print(Markdown(text))
    else:
        typer.echo(text, nl=False)


def new(folder: Path) -> None:
    """Writes the template block folder.

    Raises:
        FileExistsError: if the path is a file, or a folder that is not empty.
    """
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder} is a file; give the name of a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"folder {folder} is not empty; give the name of a new or an empty folder")
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(TEMPLATE.iterdir()):
        (folder / path.name).write_bytes(path.read_bytes())
        typer.echo(f"{folder / path.name}")
    typer.echo(f"Adjust it without changes, then replace its data by your own:\n  jaxbundle adjust {folder}")
