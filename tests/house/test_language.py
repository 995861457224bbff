"""The language is that of the field: phrases that a reader has to decode are not used.

Each phrase is a regular expression with what to write instead. Blocks of code are not searched. To search another
folder, add it to `SEARCHED`.
"""

import re
from pathlib import Path

import pytest
from cases.documents import FENCE

ROOT = Path(__file__).parents[2]
SEARCHED = ("README.md", "jaxbundle/docs")  # files and folders
SUFFIXES = (".md",)
COUNTED = (
    "row|rows|line|lines|number|numbers|device|devices|set|folder|table|component|unknown|unknowns|elements|products|"
    "residuals|block|value|byte|bytes|seconds|processes|panel|unit|one"
)
OWNERS = (
    "image|ray|point|camera|tile|core|machine|block|group|kind|observation|process|strip|model|row|cause|step|device|"
    "photograph|joint|iteration|station"
)
BANNED = {
    rf"\b({COUNTED}) an? ({OWNERS})\b(?! (of|is|has|that|to))": "one row per image",
    r"\b(is|are|was) no (finite|positive|number|folder|file|camera|image|block|rotation|checkpoint|module|option)\b": (
        "is not a ..."
    ),
    r"\bof every (image|point|ray|unknown|group|observation)\b": "for each",
    r"\bat most so many\b|\bby so many\b": "maximum number",
    r"\bis told\b|\bare told\b|\btells of\b": "the report says, names",
    r"\bwhat is given\b|\bof what is given\b": "input values",
    r"\bthe most is\b|\bthe least is\b": "maximum, minimum",
    r"\bdealt (to|out)\b": "distributed over",
    r"\bgoes on from\b|\bgo on from\b": "resumes from",
    r"\btakes? the weight of\b": "down-weights",
    r"\bstops no other\b|\bfrom nothing\b": "does not stop the others; without initial values",
    r"\bso that .* go together\b": "can be batched",
    r"\bof one's own\b|\bof their own accord\b": "your own",
    r"\bmeasure again or drop\b": "re-measure or remove",
    r"\bthe sigmas given\b|\bsigmas? that (was|were) given\b": "the given sigmas",
    r"\bheld against\b|\bholds? .{1,40} against\b": "compared with",
    r"\bheld (at|fixed|unknowns?|elements?|values?|control)\b|\b(is|are|be) held\b": "fixed",
    r"\bmake no matter\b|\bno matter of\b|\bby heart\b": "plain words",
    r"\bthe textbook's\b|\bthe text 00\d\b(?!\")": "a key of the bibliography page",
    r"\bkept (matrix|unknowns|points|rays)\b|\bpool of blocks\b|\bthe pool\b": "reduced normal equations",
    r"\b(?:MOST|LEAST|LARGEST)_[A-Z]+\b": "MAX_..., MIN_...",
    r"\bsession\b|\bworking paper\b|\bissue \d": "the project speaks of itself alone",
}


def searched_files() -> list[Path]:
    """All files that are searched."""
    paths = [ROOT / name for name in SEARCHED]
    files = [path for path in paths if path.is_file()]
    files += [file for path in paths if path.is_dir() for file in path.rglob("*") if file.suffix in SUFFIXES]
    return sorted(files)


def found(text: str) -> list[str]:
    """Banned phrases of a text, each with its line and what to write."""
    prose = FENCE.sub(lambda block: "\n" * block[0].count("\n"), text)
    hits = [
        (prose.count("\n", 0, hit.start()) + 1, hit[0], instead)
        for pattern, instead in BANNED.items()
        for hit in re.finditer(pattern, prose, re.IGNORECASE)
    ]
    return [f"line {line}: {phrase!r}; write: {instead}" for line, phrase, instead in sorted(hits)]


@pytest.mark.parametrize("file", searched_files(), ids=lambda path: path.name)
def test_no_banned_phrase(file):
    assert not found(file.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "sentence",
    [
        "The table has one row an image.",
        "one device a core",
        "X is no finite number",
        "the path is no folder",
        "derivatives of every unknown",
        "3 rays are off; measure again or drop what is no error",
        "the interior is held fixed",
    ],
)
def test_the_list_finds(sentence):
    assert found(sentence)


@pytest.mark.parametrize(
    "sentence",
    ["one row per image", "X is not a finite number", "there is no table of points", "each number has a unit"],
)
def test_the_list_leaves_good_sentences(sentence):
    assert not found(sentence)
