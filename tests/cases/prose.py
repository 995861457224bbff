"""The prose of a Python file: docstrings, comments and string literals, without code.

Not prose: names between backticks, doctest lines with their output, the expressions of f-strings, the dotted names of
modules, strings without a blank (keys, units, names of columns).
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator

CODE = re.compile(r"`[^`\n]*`")
DOCTEST = re.compile(r"^[ \t]*>>> .*(?:\n[ \t]*\S.*)*", re.MULTILINE)
PLACEHOLDER = re.compile(r"\{[^{}]*\}")
STRING = re.compile(r"""^([rRbBuUfF]*)("{3}|'{3}|"|')(.*)\2$""", re.DOTALL)


def blanked(pattern: re.Pattern[str], text: str) -> str:
    """The text with every match replaced by blanks; ends of lines stay, so that the numbers of the lines stay."""
    return pattern.sub(lambda hit: re.sub(r"[^\n]", " ", hit[0]), text)


def words_of_string(literal: str) -> str:
    """The words of a string literal; none of a key."""
    match = STRING.match(literal)
    if match is None or not re.search(r"\s", match[3]):
        return ""
    text = blanked(PLACEHOLDER, match[3]) if "f" in match[1].lower() else match[3]
    return blanked(DOCTEST, text)


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Line number and words of each comment and string literal of a file.

    Comments on successive lines and literals that follow each other are joined: a phrase may be broken at the end of a
    line.
    """
    line, words, kind, end = 1, "", None, 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT):
            continue
        text = None
        if token.type == tokenize.COMMENT:
            text = token.string.lstrip("#")
        elif token.type == tokenize.STRING:
            text = words_of_string(token.string)
        if text is not None and kind == token.type and token.start[0] <= end + 1:
            words += "\n" * (token.start[0] - end) + text
        else:
            if words.strip():
                yield line, blanked(CODE, words)
            line, words = token.start[0], text or ""
        kind, end = (token.type if text is not None else None), token.end[0]
    if words.strip():
        yield line, blanked(CODE, words)


def first_lines(source: str) -> Iterator[tuple[int, str]]:
    """Line number and first docstring line of the module, its public classes, functions and methods."""

    def visit(node: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
        for child in node.body:
            if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
                yield from first(child, child.lineno)
                if isinstance(child, ast.ClassDef):
                    yield from visit(child)

    def first(node: ast.Module | ast.ClassDef | ast.FunctionDef, line: int) -> Iterator[tuple[int, str]]:
        docstring = ast.get_docstring(node)
        if docstring is not None:
            yield line, docstring.partition("\n")[0]

    module = ast.parse(source)
    yield from first(module, 1)
    yield from visit(module)
