"""The pages of the documentation and the README, and the blocks of code in them."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "jaxbundle" / "docs"
README = ROOT / "README.md"
PAGES = {path.stem: path for path in sorted(DOCS.glob("*.md"))}
FENCE = re.compile(r"^```(.*?)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


class CodeBlock(NamedTuple):
    """A fenced block: its words behind the fence, such as "python", and its text."""

    words: tuple[str, ...]
    text: str


def text_of(path: Path) -> str:
    """The text of a page."""
    return path.read_text(encoding="utf-8")


def code_blocks(path: Path) -> list[CodeBlock]:
    """All fenced blocks of a page in order."""
    return [CodeBlock(tuple(words.split()), text) for words, text in FENCE.findall(text_of(path))]


def links(path: Path) -> list[str]:
    """Targets of all links of a page, those in blocks of code left out."""
    return LINK.findall(FENCE.sub("", text_of(path)))
