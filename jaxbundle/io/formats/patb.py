"""Reading and writing PATB: image coordinates .im, control .con and orientations .ori with the same name.

    .im     photo c, then point x y [group] about the principal point, y up, in micrometres; -99 after each photo
    .con    point X Y [group] ..., -99, then point Z [group] ..., -99
    .ori    three records for each photo: (I16, 16X, 3F16.5) photo X Y Z;  (5F16.12) a11 a12 a13 a21 a22;
            (4F16.12) a23 a31 a32 a33

Columns of .ori have fixed width and may touch. The rays decide whether the matrix is object_from_image or its inverse,
and the unit of the image coordinates. Source: PCI Geomatica, OrthoEngine, "PAT-B exterior orientation".
"""

import dataclasses
from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.io.formats.collected import (
    CONTROL,
    CONTROL_SIGMAS,
    IN_MM,
    SIGMA,
    Collected,
    mm_camera,
    scaled,
    transposed,
)
from jaxbundle.io.formats.foreign_block import DEFAULT, Alternative, ForeignBlock, Known, ReadOptions, element
from jaxbundle.io.formats.metric_form import in_mm
from jaxbundle.io.formats.photo_rows import END, photo_rows, read_photo_rows, written_names
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.formats.written import losses_of_block
from jaxbundle.io.noted import Noted

WIDTH = 16  # characters of a number in .ori
MICROMETRES = 1e-3  # mm
LONGEST = 2000.0  # mm: a larger principal distance is in micrometres


def _files(path: Path) -> list[Path]:
    """The files .im, .ori and .con of a PATB project; empty for any other path."""
    if path.is_dir():
        found = sorted(path.glob("*.im"))
        return _files(found[0]) if len(found) == 1 else []
    files = [path.with_suffix(suffix) for suffix in (".im", ".ori", ".con")]
    return files if path.suffix in (".im", ".ori") and all(file.is_file() for file in files[:2]) else []


def is_patb(path: Path) -> bool:
    """Whether a path is a folder with one .im and its .ori, or one of these files."""
    return bool(_files(path))


def read_patb(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the block of .im, .ori and, if it exists, .con.

    Raises: BlockError with all problems.
    """
    files = _files(path)
    if not files:
        raise BlockError([Problem(f"{path} has no .im with an .ori of the same name", "add both files")])
    noted, found = Noted(), Collected()
    cameras = _image_points(files[0], found, noted)
    _orientations(files[1], found, noted)
    if files[2].is_file():
        _control(files[2], found, noted)
    if noted:
        raise noted.error()
    names = [f"{c:.12g}" for c in sorted(set(cameras.values()))] or ["0"]
    found.camera = {photo: f"{c:.12g}" for photo, c in cameras.items()}
    unit = MICROMETRES if max(cameras.values(), default=0.0) > LONGEST else 1.0
    foreign = ForeignBlock(
        format="PATB project",
        name=files[0].stem,
        cameras=tuple(mm_camera(f"camera {name}", float(name) * unit) for name in names),
        images=found.images_with(names, lambda rows: np.full((len(rows), 3, 3), np.nan)),
        points=found.points_found(),
        rays=found.ray_table(),
        control=found.measured_control(),
        sigma=SIGMA,
        assumptions=(IN_MM, CONTROL) if found.control else (IN_MM,),
        reading="with the matrix as object from image",
    )
    other = 1 / MICROMETRES if unit == MICROMETRES else MICROMETRES
    return dataclasses.replace(
        scaled(foreign, unit),
        alternatives=(
            Alternative("with the matrix as image from object", transposed),
            Alternative("with image coordinates in another unit than c", lambda one: scaled(one, other)),
            Alternative("with both", lambda one: scaled(transposed(one), other)),
        ),
    )


def _image_points(path: Path, found: Collected, noted: Noted) -> dict[str, float]:
    """Rays, and the principal distance of each photo."""
    cameras: dict[str, float] = {}

    def head(line: int, fields: list[str]) -> None:
        values = numbers(path, line, fields[1:2], noted) if len(fields) > 1 else None
        if len(fields) < 2:
            noted.add(path.name, line, "the photo has no principal distance", AGAIN)
        cameras[fields[0]] = values[0] if values else 0.0

    read_photo_rows(path, found, noted, head)
    return cameras


def _columns(text: str) -> list[str]:
    """Fields of fixed width, or fields between blanks in files without fixed width."""
    fixed = [text[k : k + WIDTH].strip() for k in range(0, len(text.rstrip()), WIDTH)]
    return [field for field in fixed if field] if all(" " not in field for field in fixed) else text.split()


def _orientations(path: Path, found: Collected, noted: Noted) -> None:
    lines = [(k, text) for k, text in enumerate(lines_of(path), 1) if text.strip()]
    for k in range(0, len(lines), 3):
        fields = [_columns(text) for _, text in lines[k : k + 3]]
        line = lines[k][0]
        if [len(one) for one in fields] != [4, 5, 4]:
            what = f"the photo has records of {', '.join(str(len(one)) for one in fields)} fields, not 4, 5 and 4"
            noted.add(path.name, line, what, AGAIN)
            return
        values = numbers(path, line, [*fields[0][1:], *fields[1], *fields[2]], noted)
        if values is not None:
            name = fields[0][0]
            found.image(name)
            found.orientation[name] = np.array(values[:3]), np.zeros(3)
            found.matrix[name] = np.array(values[3:]).reshape(3, 3)


def _control(path: Path, found: Collected, noted: Noted) -> None:
    """Reads plan, then height; a point may have only one of them."""
    plan: dict[str, list[float]] = {}
    heights: dict[str, float] = {}
    part = 0
    for line, text in enumerate(lines_of(path), 1):
        fields = text.split()
        if not fields:
            continue
        if fields[0] == END:
            part += 1
            continue
        if part > 1:
            break
        values = numbers(path, line, fields[1 : 3 - part], noted) if len(fields) > 2 - part else None
        if len(fields) <= 2 - part:
            noted.add(path.name, line, f"the control point has {len(fields)} fields, too few", AGAIN)
        if values is not None and part == 0:
            plan[fields[0]] = values
        elif values is not None:
            heights[fields[0]] = values[0]
    for name in dict.fromkeys([*plan, *heights]):
        x, y = plan.get(name, (np.nan, np.nan))
        place = (x, y, heights.get(name, np.nan))
        sigmas = tuple(s if np.isfinite(v) else np.nan for s, v in zip(CONTROL_SIGMAS, place, strict=True))
        found.control[name] = Known(name, place, (sigmas[0], sigmas[1], sigmas[2]))


def write_patb(block: Block, path: Path) -> list[str]:
    """Writes NAME.im, NAME.con and NAME.ori into a folder.

    Returns: sentences about what the format cannot represent.
    """
    foreign, losses = in_mm(block)
    path.mkdir(parents=True, exist_ok=True)
    images, points = written_names(foreign, path, losses)
    cameras = [foreign.cameras[k] for k in foreign.images.camera]
    middle = [(element(camera, "x0"), element(camera, "y0")) for camera in cameras]

    def head(k: int) -> str:
        return f"{images[k]:>16} {element(cameras[k], 'principal_distance') / MICROMETRES:.6f}"

    def row(point: str, k: int, x: float, y: float) -> str:
        x, y = (x - middle[k][0]) / MICROMETRES, (y - middle[k][1]) / MICROMETRES
        return f"{point:>16} {x:.6f} {y:.6f} 1"

    (path / f"{path.name}.im").write_text(photo_rows(foreign, points, head, row), encoding="utf-8")
    rows = []
    for k, name in enumerate(images):
        r = foreign.images.rotation[k].ravel()
        rows.append(f"{name:>16}{'':16}" + "".join(f"{value:16.5f}" for value in foreign.images.centre[k]))
        rows += ["".join(f"{value:16.12f}" for value in r[:5]), "".join(f"{value:16.12f}" for value in r[5:])]
    (path / f"{path.name}.ori").write_text("\n".join(rows) + "\n", encoding="utf-8")
    position = dict(zip(foreign.points.names, points, strict=True))
    control = [row for row in foreign.control if not row.check]
    rows = [f"{position[r.name]} {r.coordinates[0]:.6f} {r.coordinates[1]:.6f} 1" for r in control if _has(r, 0, 1)]
    rows.append(END)
    rows += [f"{position[r.name]} {r.coordinates[2]:.6f} 1" for r in control if _has(r, 2)]
    (path / f"{path.name}.con").write_text("\n".join([*rows, END]) + "\n", encoding="utf-8")
    losses.append("principal points: written image coordinates are relative to them")
    losses.append("object points and standard deviations; centres are rounded to 0.01 mm")
    return [*losses, *losses_of_block(block, frozenset({"control"}))]


def _has(row: Known, *axes: int) -> bool:
    return all(np.isfinite(row.coordinates[axis]) and np.isfinite(row.sigmas[axis]) for axis in axes)
