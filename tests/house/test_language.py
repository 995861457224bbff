"""The language is that of the field: phrases that a reader has to decode are not used.

Each phrase is a regular expression with what to write instead. Pages are searched without their blocks of code; of
Python files docstrings, comments and strings are searched (see `cases/prose.py`). `BANNED` is for all files,
`IN_CODE` for Python files only.
"""

import re
from pathlib import Path

import pytest
from cases.documents import FENCE
from cases.prose import first_lines, prose

ROOT = Path(__file__).parents[2]
SEARCHED = ("README.md", "jaxbundle")  # files and folders
SUFFIXES = (".md", ".py")
COUNTED = (
    "row|rows|line|lines|number|numbers|device|devices|set|folder|table|component|unknown|unknowns|elements|products|"
    "residuals|block|value|byte|bytes|seconds|processes|panel|unit|one"
)
OWNERS = (
    "image|ray|point|camera|tile|core|machine|block|group|kind|observation|process|strip|model|row|cause|step|device|"
    "photograph|joint|iteration|station|chunk|partial|component|call|solve|class"
)
NO = r"(?<!there\s)\b(is|are|was|were) no"
BANNED = {
    rf"\b({COUNTED}) an? ({OWNERS})\b(?! (of|is|has|that|to))": "one row per image",
    rf"{NO} (finite|positive|number|folder|file|camera|image|block|rotation|checkpoint|module|option)\b": (
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
    r"(?-i:\b(?:MOST|LEAST|LARGEST)_[A-Z]+\b)": "MAX_..., MIN_...",
    r"\bsession\b|\bworking paper\b|\bissue \d": "the project speaks of itself alone",
}
IN_CODE = {
    rf"{NO} (numbers|valid|plain|points?|coordinates?|TOML|JSON|XML|rays)\b": "is not a ...",
    r"\bso many\b|\bby so much\b": "a number of, a maximum number of",
    r"\b(?:what|which) (?:it|he|one) (?:tells|says)\b|\btold apart\b|\bcannot be told\b": "distinguish, report",
    r"\btold\b|\btells?\b(?!:)": "reports, shows, names",
    r"\bkept (?:in|beside|for|as|from|by)\b": "stored, saved, unchanged",
    r"\bheld\b(?! control| column)": "fixed",
    r"\bof (?:its|their|one's) own kind\b": "a separate ...",
    r"\bin (?:the|their|its) place of\b|\btakes? the place of\b": "instead of, replaces",
    r"\bgo(?:es)? through (?:it|jit|grad|vmap)\b|\bvmap go through\b": "works with jit, grad and vmap",
    r"\bgo(?:es)? on\b": "continues, resumes",
    r"\banew\b(?!:)|\bonce more\b": "again",
    r"\btakes? (?:no )?part\b": "is used, is not used",
    r"\b(?:adjusted|computed|observed|second|true|given) less (?:adjusted|observed|first|true|given|known)\b": "minus",
    r"\b(?:outside|inside) of\b": "outside, inside",
    r"\bmeasured? (?:it |them |the rays? )?again\b": "re-measure",
    r"\bsecond opinion\b": "an independent solver",
    r"\bwhoever\b|\bwhatever\b": "plain words",
    r"\bby (?:turns|itself)\b": "alternately, separately",
    r"\bpulled after\b|\bdrawn aside\b|\baccuses? (?:anybody|the innocent)\b|\bthe culprits?\b": "plain words",
    r"\bis worth\b|\bat hand\b|\bgood to know\b|\bto be had\b": "plain words",
    r"\bBlockError with (?:all|everything|what) (?:that )?is wrong\b": "BlockError with all problems",
}


def searched_files() -> list[Path]:
    """All files that are searched."""
    paths = [ROOT / name for name in SEARCHED]
    files = [path for path in paths if path.is_file()]
    files += [file for path in paths if path.is_dir() for file in path.rglob("*") if file.suffix in SUFFIXES]
    return sorted(files)


def hits(words: str, phrases: dict[str, str], first: int = 1) -> list[str]:
    """Banned phrases of words that begin on a line, each with its line and what to write."""
    one_line = words.replace("\n", " ")
    return [
        f"line {words.count(chr(10), 0, hit.start()) + first}: {hit[0]!r}; write: {instead}"
        for pattern, instead in phrases.items()
        for hit in re.finditer(pattern.replace(" ", r"\s+"), one_line, re.IGNORECASE)
    ]


def found(text: str) -> list[str]:
    """Banned phrases of a page."""
    return hits(FENCE.sub(lambda block: "\n" * block[0].count("\n"), text), BANNED)


def found_in_code(source: str) -> list[str]:
    """Banned phrases in the docstrings, comments and strings of a Python file."""
    return [hit for line, words in prose(source) for hit in hits(words, BANNED | IN_CODE, line)]


@pytest.mark.parametrize("file", searched_files(), ids=lambda path: str(path.relative_to(ROOT)))
def test_no_banned_phrase(file):
    text = file.read_text(encoding="utf-8")
    assert not (found_in_code(text) if file.suffix == ".py" else found(text))


def test_first_docstring_lines_are_whole_statements():
    """Each stands alone in a hover window: at least four words, a full stop, no continuation of a name."""
    wrong = [
        f"{file.relative_to(ROOT)}:{line}: {first}"
        for file in searched_files()
        if file.suffix == ".py"
        for line, first in first_lines(file.read_text(encoding="utf-8"))
        if not first.endswith(".") or len(first.split()) < 4 or re.match(r"(Of|The same|As|See)\b", first)
    ]
    assert not wrong, "\n".join(wrong)


def test_only_prose_of_code_is_searched():
    source = '''"""One row an image."""\nheld = {"held": f"{told} is fixed"}  # is no finite\n# number\n'''
    assert [line.partition(":")[0] for line in found_in_code(source)] == ["line 1", "line 2"]


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
