"""What is wrong in block.toml, in words: problems that pydantic finds, each with a cure."""

import json
from pathlib import Path
from typing import Any

from pydantic_core import ErrorDetails

from jaxbundle.block.problems import shown
from jaxbundle.io.settings import SECTIONS, Settings, TableNames

OF_NAMES = ("cameras", "navigation")  # sections of which each has a name
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
    "images": 'images = "images.csv"',
    "rays": 'rays = "rays.csv"',
    "type": 'type = "inner"',
}
SHOWN_FILES = ("images", "rays", "points", "control", "stations", "attitudes")  # of a missing section [tables]


def in_words(error: ErrorDetails, loc: tuple[str, ...], folder: Path) -> tuple[str, str]:
    """A finding of pydantic as problem and cure; `folder` is that of the block."""
    given, key = _given(error["input"]), loc[-1]
    section = f"[{'.'.join(map(shown, loc[: 2 if loc[0] in OF_NAMES else 1]))}]"
    where = " ".join((section, shown(loc[-1])) if len(loc) > 1 else loc)
    match error["type"]:
        case "problem":
            context = error.get("ctx", {})
            return f"{section} {context['what']}", context["cure"]
        case "missing":
            return _missing(where, loc, folder)
        case "extra_forbidden":
            known = (SECTIONS[loc[2] if len(loc) > 3 else loc[0]] if len(loc) > 1 else Settings).model_fields
            return f"{where} is unknown", f"known here: {', '.join(known)}"
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
            return f"{where} is {given}", f'give a text in quotes, such as {key} = "{given}"'
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
        there = [kind for kind in TableNames.model_fields if (folder / f"{kind}.csv").is_file()]
        files = ", ".join(f'{kind} = "{kind}.csv"' for kind in there or SHOWN_FILES[:2])
        return "[tables] is missing", f"add it and name the tables below it: [tables] {files}"
    said = f"[{name}]" if len(loc) == 1 and name != "format" else where
    example = EXAMPLES.get(name, "")
    return f"{said} is missing", f"give it, such as {example}" if example else "give it"
