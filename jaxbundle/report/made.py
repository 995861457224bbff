"""How a report was made: program, date, command, inputs with their hashes, units, and signs and formulas."""

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
    ("Residual v", "computed less observed; y of images points up; differences at points are adjusted less given."),
    ("sigma0", "sqrt(vTPv / redundancy). With right sigmas it lies between the limits of the global test, near 1."),
    (
        "Standard deviation sd",
        "sigma0 times the root of the cofactor, from the inverse of the normal equations. It is internal: it tells"
        " what random errors do, not what systematic ones did.",
    ),
    (
        "Redundancy number r",
        "the part of an error that shows in its own residual, 0 to 1; below 0.04 an error cannot be seen.",
    ),
    ("Standardised residual w", "v / (sigma sqrt(r)); |w| / sigma0 above 3.3 happens by chance once in 1000."),
    ("MDE", "sigma 4.13 / sqrt(r): the smallest error found with a power of 80 % at a level of 0.1 %."),
    (
        "Check points",
        "took no part, so their differences are external accuracy. t = difference / sd; where sd is honest, 95 of 100"
        " lie within 2.",
    ),
)


class Made(NamedTuple):
    """What made a result. `inputs`: names and SHA-256 of the files that were read; `date`: UTC, "" for none."""

    version: str
    date: str = ""
    command: str = ""
    inputs: tuple[tuple[str, str], ...] = ()


def program_version() -> str:
    """The version of the program, as it is installed."""
    try:
        return version("jaxbundle")
    except PackageNotFoundError:  # used from its source
        return "not installed"


def made_now(command: str = "", inputs: Iterable[Path] = ()) -> Made:
    """This moment, the command, and the files as they are now."""
    hashed = [(path.name, _digest(path)) for path in inputs]
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Made(program_version(), date, command, tuple(hashed))


def _digest(path: Path) -> str:
    """SHA-256 of a file; a file beside the tables that cannot be read must not end an adjustment."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "not readable"


def input_files(path: Path) -> list[Path]:
    """The files that a block at this path is read from: its own file, or block.toml and the tables of its folder."""
    if path.is_file() and path.name != SETTINGS:
        return [path]
    folder = path if path.is_dir() else path.parent
    files = {file for file in folder.iterdir() if file.suffix in (".csv", ".toml")}
    if (folder / SETTINGS).is_file():
        tables = tomllib.loads((folder / SETTINGS).read_text(encoding="utf-8-sig", errors="replace")).get("tables", {})
        files |= {folder / name for name in tables.values() if isinstance(name, str)}
    return sorted(file for file in files if file.is_file())


def made_section(figures: Figures, made: Made | None = None) -> Section:
    """Program, inputs, units, rotation, signs; without `made` the version of the program alone."""
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
