"""Origin of a report: program, date, command, inputs with their hashes, units, signs and formulas."""

import hashlib
import tomllib
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from jaxbundle.report.figures import Figures
from jaxbundle.report.section import Chapter, Facts, Section, fact

SETTINGS = "block.toml"
FORMULAS = (
    ("Residual v", "computed - observed; y of images points up; differences at points are adjusted - given."),
    ("sigma0", "sqrt(vTPv / redundancy). With correct sigmas it is near 1, between the limits of the global test."),
    (
        "Standard deviation sd",
        "sigma0 times the root of the cofactor, from the inverse of the normal equations. It is internal: it measures"
        " the effect of random errors, not of systematic ones.",
    ),
    (
        "Redundancy number r",
        "the part of an error that appears in its residual, 0 to 1; below 0.04 an error stays hidden.",
    ),
    ("Standardised residual w", "v / (sigma sqrt(r)); |w| / sigma0 above 3.3 happens by chance once in 1000."),
    ("MDE", "sigma 4.13 / sqrt(r): the minimum error detected with a power of 80 % at a level of 0.1 %."),
    (
        "Check points",
        "were not used, so their differences are external accuracy. t = difference / sd; with realistic sd, 95 of 100"
        " are within 2.",
    ),
)


class Made(NamedTuple):
    """Origin of a result. `inputs`: names and SHA-256 of the files that were read; `date`: UTC, "" if unknown."""

    version: str
    date: str = ""
    command: str = ""
    inputs: tuple[tuple[str, str], ...] = ()


def program_version() -> str:
    """The installed version of the program."""
    try:
        return version("jaxbundle")
    except PackageNotFoundError:  # used from the source tree
        return "not installed"


def made_now(command: str = "", inputs: Iterable[Path] = ()) -> Made:
    """The current time, the command, and the present state of the files."""
    hashed = [(path.name, _digest(path)) for path in inputs]
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Made(program_version(), date, command, tuple(hashed))


def _digest(path: Path) -> str:
    """SHA-256 of a file; an additional file that cannot be read must not stop an adjustment."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "not readable"


def input_files(path: Path) -> list[Path]:
    """The files of the block at this path: its single file, or block.toml and the tables of its folder."""
    if path.is_file() and path.name != SETTINGS:
        return [path]
    folder = path if path.is_dir() else path.parent
    files = {file for file in folder.iterdir() if file.suffix in (".csv", ".toml")}
    if (folder / SETTINGS).is_file():
        tables = tomllib.loads((folder / SETTINGS).read_text(encoding="utf-8-sig", errors="replace")).get("tables", {})
        files |= {folder / name for name in tables.values() if isinstance(name, str)}
    return sorted(file for file in files if file.is_file())


def made_section(figures: Figures, made: Made | None = None) -> Section:
    """Program, inputs, units, rotation, signs; without `made` only the version of the program."""
    made = made or Made(program_version())
    structure = figures.structure
    images = sorted({camera.image_unit for camera in structure.cameras})
    angles = ", ".join(structure.rotation_system.angles)
    facts = [fact("Program", f"jaxbundle {made.version}", program=f"jaxbundle {made.version}")]
    if made.date:
        facts.append(fact("Date", made.date, date=made.date))
    if made.command:
        facts.append(fact("Command", made.command, command=made.command))
    if made.inputs:
        words = "; ".join(f"{name} {digest[:16]}" for name, digest in made.inputs)
        facts.append(fact("Inputs, SHA-256", words, inputs=dict(made.inputs)))
    units = f"object {structure.object_unit}, angles {structure.angle_unit}, images {' and '.join(images)}"
    facts += [
        fact("Units", units),
        fact("Rotation", f"{structure.rotation_system.name}: {angles}", rotation=structure.rotation_system.name),
        *(fact(*formula) for formula in FORMULAS),
    ]
    return Section("How it was made", (Facts(tuple(facts), 26),), Chapter.MADE)
