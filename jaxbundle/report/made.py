"""How a report was made: program, date, command, inputs with their hashes, units, and signs and formulas."""

import hashlib
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from jaxbundle.report.figures import Figures
from jaxbundle.report.section import Chapter, Facts, Section, fact

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
    """This moment, the command, and the files as they are now.

    Raises: OSError for a file that cannot be read.
    """
    hashed = []
    for path in inputs:
        with path.open("rb") as file:
            hashed.append((path.name, hashlib.file_digest(file, "sha256").hexdigest()))
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Made(program_version(), date, command, tuple(hashed))


def input_files(path: Path) -> list[Path]:
    """The files that a block at this path is read from: its own file, or the tables of its folder."""
    if path.is_file():
        return [path]
    return sorted(file for file in path.iterdir() if file.is_file() and file.suffix in (".csv", ".toml"))


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
