"""Reading and writing block.toml; each problem is reported with its line."""

import functools
import json
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from jaxbundle.block.problems import is_hidden, shown
from jaxbundle.block.wording import RADIANS
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA, ROTATION_SYSTEMS, RotationSystem
from jaxbundle.io.block_tables import REQUIRED, TABLES
from jaxbundle.io.noted import Noted, listed
from jaxbundle.io.settings import SECTIONS, Settings
from jaxbundle.io.text_files import read_text

FILE = "block.toml"
LONGEST = 4_000_000  # characters: thousands of cameras
MANY = 50  # problems of one block.toml that are reported
UNQUOTED = re.compile(r"([A-Za-z0-9_-]+)\s*=\s*([^\W\d][^\"'\[\]{}=#]*)")  # key = text without quotes
OF_NAMES = ("cameras", "navigation")  # sections with a name
EXAMPLES = {
    "format": "format = 1",
    "units": '[units] object = "m", angle = "deg"',
    "object": 'object = "m"',
    "angle": 'angle = "deg"',
    "rotation": '[rotation] system = "omega-phi-kappa"',
    "system": 'system = "omega-phi-kappa"',
    "cameras": '[cameras.NAME] image_unit = "px", principal_distance = 3000.0, principal_point = [2000.0, 1500.0]',
    "image_unit": 'image_unit = "px"',
    "principal_distance": "principal_distance = 50.0, in mm, or in px for a camera in px without pixel_size",
    "image": "image = 0.5, in the unit of the rays",
    "type": 'type = "inner"',
}
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class BlockToml:
    """`settings` is None where the file has a problem; `raw` is the part that could be read, `text` the file."""

    settings: Settings | None
    raw: dict[str, Any]
    text: str

    @property
    def tables(self) -> dict[str, str]:
        """File names of the tables that are given; the usual names where none is given."""
        given = self.raw.get("tables")
        if not isinstance(given, dict) or not given:
            given = {kind: TABLES[kind].file for kind in REQUIRED}
        return {kind: file for kind, file in given.items() if kind in TABLES and isinstance(file, str)}

    @property
    def camera_names(self) -> tuple[str, ...] | None:
        """Names of the cameras; None where they could not be read."""
        cameras = self.raw.get("cameras")
        return tuple(cameras) if isinstance(cameras, dict) else None

    @property
    def navigation_names(self) -> tuple[str, ...]:
        """Names of the navigation groups."""
        groups = self.raw.get("navigation")
        return tuple(groups) if isinstance(groups, dict) else ()

    @property
    def rotation_system(self) -> RotationSystem:
        """The rotation system; where it could not be read, omega-phi-kappa, the most frequent one."""
        section = self.raw.get("rotation")
        name = section.get("system") if isinstance(section, dict) else None
        return ROTATION_SYSTEMS.get(str(name), OMEGA_PHI_KAPPA)

    @property
    def half_turn(self) -> float:
        """Half a turn in the unit of the angles; 180 degrees where the unit could not be read."""
        return math.pi / RADIANS[self.settings.units.angle if self.settings else "deg"]

    @property
    def sigma(self) -> float | None:
        """Default standard deviation of the rays; None where it is not given."""
        return self.settings.sigma.image if self.settings and self.settings.sigma else None

    def line(self, *path: str) -> int:
        """Line of a key or of the innermost section around it; 0 where there is none."""
        return line_of(self.text, path)


def read_block_toml(path: Path, noted: Noted) -> BlockToml:
    """Reads block.toml at this path; all its problems are noted."""
    text = read_text(path, noted)
    if text is None:
        return BlockToml(None, {}, "")
    raw = parsed_toml(path.name, text, noted)
    if raw is None:
        return BlockToml(None, {}, text)
    for where in hidden_texts(raw):
        what = f"{' '.join(map(shown, where))} has an invisible character"
        noted.add(path.name, line_of(text, where), what, "delete this character")
    return validated(raw, text, noted, path)


def validated(raw: dict[str, Any], text: str, noted: Noted, path: Path) -> BlockToml:
    """Checks settings and notes all problems; `text`: the text of their file, if there is one."""
    try:
        return BlockToml(Settings.model_validate(raw), raw, text)
    except ValidationError as error:
        alike: dict[tuple, list[ErrorDetails]] = {}
        details = error.errors(include_url=False)
        unknown = {detail["loc"][:-1] for detail in details if detail["loc"][-1] == "[key]"}
        for detail in (detail for detail in details if detail["loc"] not in unknown):
            loc: tuple[int | str, ...] = detail["loc"]
            kind = loc[0], loc[2:], detail["msg"]  # the same in many sections
            alike.setdefault(kind if kind[0] in OF_NAMES and len(loc) > 2 else loc, []).append(detail)
        for first, *others in list(alike.values())[:MANY]:
            loc = tuple(str(part) for part in first["loc"])
            what, cure = _in_words(first, loc, path.parent)
            also = f"; likewise {listed([str(other['loc'][1]) for other in others])}" if others else ""
            noted.add(path.name, line_of(text, loc), what + also, cure)
        return BlockToml(None, raw, text)


def _in_words(error: ErrorDetails, loc: tuple[str, ...], folder: Path) -> tuple[str, str]:
    """A validation error of pydantic as problem and cure; `folder` is that of the block."""
    if error["type"] == "missing":
        return _missing(_place(loc)[1], loc, folder)
    if error["type"] == "extra_forbidden":
        known = (SECTIONS[loc[2] if len(loc) > 3 else loc[0]] if len(loc) > 1 else Settings).model_fields
        return f"{_place(loc)[1]} is unknown", f"known keys: {', '.join(known)}"
    return value_in_words(error, loc)


def _place(loc: tuple[str, ...]) -> tuple[str, str]:
    """The section of a key, and the key with it."""
    section = f"[{'.'.join(map(shown, loc[: 2 if loc[0] in OF_NAMES else 1]))}]"
    return section, " ".join((section, shown(loc[-1])) if len(loc) > 1 else loc)


def value_in_words(error: ErrorDetails, loc: tuple[str, ...]) -> tuple[str, str]:
    """A validation error of pydantic about a value, as problem and cure."""
    given, key = _given(error["input"]), loc[-1]
    section, where = _place(loc)
    match error["type"]:
        case "problem":
            context = error.get("ctx", {})
            return f"{section} {context['what']}", context["cure"]
        case "range":
            bounds = error.get("ctx", {})
            return (
                f"{where} is {given}, not from {bounds['smallest']} to {bounds['largest']}",
                "correct it, or its unit",
            )
        case "literal_error":
            return f"{where} is {given}", f"give {error.get('ctx', {})['expected']}"
        case "model_type" | "dict_type":
            return f"{where} is not a section", f"write it as [{'.'.join(map(shown, loc))}] and its keys below"
        case "list_type":
            return f"{where} is {given}", f"give a list in brackets, such as {key} = [{given}]"
        case "string_type":
            return f"{where} is {given}", f'put the text in quotes, such as {key} = "{given}"'
        case "float_type" | "int_type" | "float_parsing" | "int_from_float":
            return f"{where} is {given}", "give a number, without quotes and without unit"
        case "finite_number":
            return f"{where} is {given}", "give a finite number"
    return f"{where} is {given}", shown(error["msg"].replace("Input should", "it should"), 300)


def _given(value: Any) -> str:
    """A value of TOML as a message shows it."""
    return shown(json.dumps(value, ensure_ascii=False, default=str))


def _missing(where: str, loc: tuple[str, ...], folder: Path) -> tuple[str, str]:
    name = loc[-1] if len(loc) != 1 else loc[0]
    if loc == ("tables",):
        there = [kind for kind, schema in TABLES.items() if (folder / schema.file).is_file()]
        files = ", ".join(f'{kind} = "{TABLES[kind].file}"' for kind in there or REQUIRED)
        return "[tables] is missing", f"add it and name the tables below it: [tables] {files}"
    said = f"[{name}]" if len(loc) == 1 and name != "format" else where
    example = EXAMPLES.get(name, "")
    return f"{said} is missing", f"add it, such as {example}" if example else "add it"


def parsed_toml(file: str, text: str, noted: Noted) -> dict[str, Any] | None:
    """The content of a TOML file; None and a note where it is not TOML."""
    if len(text) > LONGEST:
        noted.add(file, 0, f"the file has {len(text)} characters", "give a block.toml; write rows into the tables")
        return None
    try:
        return tomllib.loads(text)
    except RecursionError:
        noted.add(file, 0, "brackets are nested too deeply", "close them")
    except ValueError as error:  # TOMLDecodeError, and numbers with thousands of digits
        place = re.search(r" \(at line (\d+), column \d+\)", str(error))
        line = int(place[1]) if place else text.rstrip().count("\n") + 1
        at = text.split("\n")[line - 1].strip()
        cure = "correct the line"
        if bare := UNQUOTED.fullmatch(at):
            cure = f'put text in quotes: {bare[1]} = "{shown(bare[2])}"'
        noted.add(file, line, f"not valid TOML: {shown(str(error).split(' (at ')[0])}: {shown(at)}", cure)
    return None


def hidden_texts(raw: dict[str, Any]) -> list[tuple[str, ...]]:
    """Paths of keys and texts with characters that are not visible; `source` may have lines."""
    found: list[tuple[str, ...]] = []
    left: list[tuple[tuple[str, ...], Any]] = [((), raw)]
    while left:
        path, value = left.pop()
        if isinstance(value, dict):
            left += [((*path, key), inner) for key, inner in value.items()]
            found += [(*path, key) for key in value if any(map(is_hidden, key))]
        elif isinstance(value, list):
            left += [(path, inner) for inner in value]
        elif isinstance(value, str) and any(c not in "\n\t" or path != ("source",) for c in filter(is_hidden, value)):
            found.append(path)
    return found


@functools.lru_cache(maxsize=4)
def _paths(text: str) -> tuple[tuple[int, tuple[str, ...]], ...]:
    """The lines of a text that open a section or set a key, each with the full path of the key."""
    section: tuple[str, ...] = ()
    found = []
    for number, line in enumerate(text.split("\n"), 1):
        opens, names = _path(line)
        if opens:
            section = names
        if opens or names:
            found.append((number, section if opens else (*section, *names)))
    return tuple(found)


def _path(line: str) -> tuple[bool, tuple[str, ...]]:
    """Whether a line of TOML opens a section, and the names of its section or key; () for any other line."""
    line = line.strip()
    opens = line.startswith("[")
    try:
        nested = tomllib.loads(line if opens else line.partition("=")[0] + "= 0")
    except (ValueError, RecursionError):
        return False, ()
    names = []
    while isinstance(nested, dict) and nested:
        ((name, nested),) = nested.items()
        names.append(name)
    return opens, tuple(names)


def line_of(text: str, path: tuple[str, ...]) -> int:
    """Line of the longest part of a path that occurs in the text; 0 where no part occurs."""
    best, found = 0, 0
    for number, here in _paths(text):
        if len(here) > best and here == path[: len(here)]:
            best, found = len(here), number
    return found


def write_block_toml(path: Path, settings: Settings) -> None:
    """Writes block.toml of a block folder."""
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
    """A value of TOML; numbers in the shortest form that reads back to the same value."""
    if isinstance(value, dict) and value:
        return "{ " + ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_value(inner) for inner in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)  # numbers, and {}
