"""Reading and writing block.toml; what is wrong in it is told with its line."""

import json
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, ROTATION_SYSTEMS, RotationSystem
from jaxbundle.io.findings import Findings
from jaxbundle.io.settings import SECTIONS, Settings, TableNames
from jaxbundle.io.tables import read_text

FILE = "block.toml"
OF_NAMES = ("cameras", "navigation")  # sections of which each has a name
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class BlockToml:
    """`settings` is None where something in the file is wrong; `raw` is what could be read, `text` the file."""

    settings: Settings | None
    raw: dict[str, Any]
    text: str

    @property
    def tables(self) -> dict[str, str]:
        """File names of the tables, as far as they are given; the usual names where none is."""
        given = self.raw.get("tables")
        if not isinstance(given, dict) or not given:
            given = {"images": "images.csv", "rays": "rays.csv"}
        return {kind: file for kind, file in given.items() if kind in TableNames.model_fields and isinstance(file, str)}

    @property
    def camera_names(self) -> tuple[str, ...] | None:
        """Names of the cameras; None where they cannot be told."""
        cameras = self.raw.get("cameras")
        return tuple(cameras) if isinstance(cameras, dict) else None

    @property
    def navigation_names(self) -> tuple[str, ...]:
        """Names of the navigation groups."""
        groups = self.raw.get("navigation")
        return tuple(groups) if isinstance(groups, dict) else ()

    @property
    def rotation_system(self) -> RotationSystem:
        """The rotation system; where none can be told, that of the angles found most often."""
        section = self.raw.get("rotation")
        name = section.get("system") if isinstance(section, dict) else None
        return ROTATION_SYSTEMS.get(str(name), OMEGA_PHI_KAPPA)

    @property
    def sigma(self) -> float | None:
        """Default standard deviation of the rays; None where it is not given."""
        return self.settings.sigma.image if self.settings and self.settings.sigma else None

    def line(self, *path: str) -> int:
        """Line of a key or of the innermost section around it; 0 where there is none."""
        return _line(self.text, path)


def read_block_toml(path: Path, findings: Findings) -> BlockToml:
    """block.toml at this path, all that is wrong in it noted."""
    text = read_text(path, findings)
    if text is None:
        return BlockToml(None, {}, "")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+), column \d+\)", str(error))
        line = int(place[1]) if place else text.rstrip().count("\n") + 1
        findings.add(path.name, line, f"no valid TOML: {str(error).split(' (at ')[0]}", "correct the line")
        return BlockToml(None, {}, text)
    try:
        return BlockToml(Settings.model_validate(raw), raw, text)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            loc = tuple(str(part) for part in detail["loc"])
            findings.add(path.name, _line(text, loc), *_in_words(detail, loc))
        return BlockToml(None, raw, text)


def _in_words(error: ErrorDetails, loc: tuple[str, ...]) -> tuple[str, str]:
    """A finding of pydantic as problem and cure."""
    section = f"[{'.'.join(loc[: 2 if loc[0] in OF_NAMES else 1])}]"
    where = " ".join((section, loc[-1]) if len(loc) > 1 else loc)
    match error["type"]:
        case "problem":
            context = error.get("ctx", {})
            return f"{section} {context['what']}", context["cure"]
        case "missing":
            return f"{where} is missing", "give it"
        case "extra_forbidden":
            known = (SECTIONS[loc[2] if len(loc) > 3 else loc[0]] if len(loc) > 1 else Settings).model_fields
            return f"{where} is unknown", f"known here: {', '.join(known)}"
        case "literal_error":
            return f"{where} is {json.dumps(error['input'])}", f"give {error.get('ctx', {})['expected']}"
        case "model_type" | "dict_type":
            return f"{where} is no section", f"write it as [{'.'.join(loc)}] and its keys below"
    return f"{where} is {error['input']!r}", error["msg"].replace("Input should", "it should")


def _path(line: str) -> tuple[bool, tuple[str, ...]]:
    """Whether a line of TOML opens a section, and the names of its section or key; () for any other line."""
    line = line.strip()
    opens = line.startswith("[")
    try:
        nested = tomllib.loads(line if opens else line.partition("=")[0] + "= 0")
    except tomllib.TOMLDecodeError:
        return False, ()
    names = []
    while isinstance(nested, dict) and nested:
        ((name, nested),) = nested.items()
        names.append(name)
    return opens, tuple(names)


def _line(text: str, path: tuple[str, ...]) -> int:
    """Line of the longest part of a path that the text names; 0 where it names none."""
    section: tuple[str, ...] = ()
    best, found = 0, 0
    for number, line in enumerate(text.split("\n"), 1):
        opens, names = _path(line)
        if opens:
            section = names
        here = section if opens else (*section, *names)
        if (opens or names) and len(here) > best and here == path[: len(here)]:
            best, found = len(here), number
    return found


def write_block_toml(path: Path, settings: Settings) -> None:
    """Writes block.toml."""
    lines, sections = [], []
    for key, value in settings.model_dump(exclude_none=True).items():
        if not isinstance(value, dict):
            lines.append(f"{key} = {_value(value)}")
        elif key in OF_NAMES:
            sections += [(f"{key}.{_key(name)}", section) for name, section in value.items()]
        else:
            sections.append((key, value))
    for name, section in sections:
        lines += ["", f"[{name}]", *(f"{_key(key)} = {_value(value)}" for key, value in section.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _key(name: str) -> str:
    return name if BARE_KEY.fullmatch(name) else _value(name)


def _value(value: object) -> str:
    """A value of TOML; numbers in the shortest form that reads back the same."""
    if isinstance(value, dict) and value:
        return "{ " + ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_value(inner) for inner in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)  # numbers, and {}
