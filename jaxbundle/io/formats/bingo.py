"""Reading and writing BINGO and BLUH: image.dat, itera.dat and geoin.dat in one folder.

    image.dat    photo [camera], then point x y in mm, -99 after each photo; # comments
    geoin.dat    CAPA camera number c x0 y0;  CONT point E N H;  CHCK point E N H;  C, * comments
    itera.dat    ORIA photo X Y Z phi omega kappa camera, gon;  CORD point X Y Z

R = R_y(phi) R_x(omega) R_z(kappa), x = x0 - c p_x / p_z, y up. Projects can use other angles: these are tried, and the
rays decide. Source: BINGO's manual as a tool of GRASS GIS reads these files (H. Turek).
"""

from pathlib import Path

import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.collected import (
    CONTROL,
    CONTROL_SIGMAS,
    IN_MM,
    SIGMA,
    Collected,
    mm_camera,
    scaled,
    with_rotations,
)
from jaxbundle.io.formats.foreign_block import DEFAULT, Alternative, ForeignBlock, Known, ReadOptions, element
from jaxbundle.io.formats.metric_form import in_mm
from jaxbundle.io.formats.photo_rows import photo_rows, read_photo_rows, short_names, written_names
from jaxbundle.io.formats.source import AGAIN, lines_of, numbers
from jaxbundle.io.formats.written import losses_of_block
from jaxbundle.io.noted import Noted

FILES = ("image.dat", "itera.dat", "geoin.dat")
GON, DEGREE = np.pi / 200, np.pi / 180


def is_bingo(path: Path) -> bool:
    """Whether a folder contains image.dat, itera.dat and geoin.dat."""
    return path.is_dir() and all((path / name).is_file() for name in FILES)


def read_bingo(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the block of a folder.

    Raises: BlockError with all problems.
    """
    noted, found = Noted(), Collected()

    def head(_: int, fields: list[str]) -> None:
        found.camera[fields[0]] = fields[1] if len(fields) > 1 else ""

    read_photo_rows(path / "image.dat", found, noted, head)
    cameras = _geoin(path / "geoin.dat", found, noted)
    _itera(path / "itera.dat", found, noted)
    names = list(cameras) or ["camera"]
    if not cameras:
        noted.add("geoin.dat", 0, "there is no camera", "add CAPA camera number c x0 y0")
    if noted:
        raise noted.error()
    images = found.images_with(names, lambda rows: rotations.matrices(rotations.phi_omega_kappa, rows * GON))
    angles = np.array(
        [found.orientation[name][1] if name in found.orientation else np.zeros(3) for name in images.names]
    )
    known = images.oriented[:, None, None]

    def other(rows: np.ndarray) -> np.ndarray:
        return np.where(known, rotations.from_angles(rows), np.nan)

    exchanged = angles[:, [1, 0, 2]]
    tried = (
        ("as omega, phi, kappa in gon, in the order phi, omega", other(exchanged * GON)),
        ("as omega, phi, kappa in gon", other(angles * GON)),
        (
            "as phi, omega, kappa in degrees",
            np.where(known, rotations.matrices(rotations.phi_omega_kappa, angles * DEGREE), np.nan),
        ),
        ("as omega, phi, kappa in degrees, in the order phi, omega", other(exchanged * DEGREE)),
    )
    return ForeignBlock(
        format="BINGO project",
        name=path.resolve().name,
        cameras=tuple(mm_camera(name, *cameras[name]) for name in names),
        images=images,
        points=found.points_found(),
        rays=found.ray_table(),
        control=found.measured_control(),
        sigma=SIGMA,
        assumptions=(IN_MM, CONTROL) if found.control else (IN_MM,),
        reading="as phi, omega, kappa in gon",
        alternatives=(
            *(Alternative(words, with_rotations(matrix)) for words, matrix in tried),
            Alternative("with image coordinates in micrometres", lambda foreign: scaled(foreign, 1e-3)),
        ),
    )


def _geoin(path: Path, found: Collected, noted: Noted) -> dict[str, tuple[float, float, float]]:
    """Reads control, and the interior orientation of each camera."""
    cameras = {}
    for line, text in enumerate(lines_of(path), 1):
        fields = text.split()
        key = fields[0].upper() if fields else ""
        if key == "CAPA" and len(fields) >= 4:
            values = numbers(path, line, fields[3:6], noted)
            if values is not None:
                cameras[fields[1]] = (*values, 0.0, 0.0)[:3]
        elif key in ("CONT", "CHCK"):
            values = numbers(path, line, fields[2:5], noted) if len(fields) >= 5 else None
            if len(fields) < 5:
                noted.add(path.name, line, f"{key} has {len(fields)} fields, not {key} point E N H", AGAIN)
            if values is not None:
                place = (values[0], values[1], values[2])
                found.control[fields[1]] = Known(fields[1], place, CONTROL_SIGMAS, key == "CHCK")
    return cameras


def _itera(path: Path, found: Collected, noted: Noted) -> None:
    """Reads orientations and coordinates of points."""
    for line, text in enumerate(lines_of(path), 1):
        fields = text.split()
        key, count = (fields[0].upper() if fields else ""), {"ORIA": 8, "CORD": 5}
        if key not in count:
            continue
        if len(fields) < count[key]:
            noted.add(path.name, line, f"{key} has {len(fields)} fields, too few", AGAIN)
            continue
        values = numbers(path, line, fields[2 : count[key]], noted)
        if values is None:
            continue
        if key == "ORIA":
            found.image(fields[1])
            found.orientation[fields[1]] = np.array(values[:3]), np.array(values[3:6])
            if len(fields) > 8 and not found.camera.get(fields[1]):
                found.camera[fields[1]] = fields[8]
        else:
            found.coordinates[fields[1]] = (values[0], values[1], values[2])


def write_bingo(block: Block, path: Path) -> list[str]:
    """Writes image.dat, itera.dat and geoin.dat into a folder.

    Returns: sentences about what the format cannot represent.
    """
    foreign, losses = in_mm(block)
    path.mkdir(parents=True, exist_ok=True)
    images, points = written_names(foreign, path, losses)
    cameras, _ = short_names(tuple(camera.name for camera in foreign.cameras))
    angles = _phi_omega_kappa(foreign.images.rotation) / GON
    rows = photo_rows(
        foreign,
        points,
        lambda k: f"{images[k]} {cameras[foreign.images.camera[k]]}",
        lambda point, _, x, y: f"  {point} {x:.9f} {y:.9f}",
    )
    (path / "image.dat").write_text(rows, encoding="utf-8")
    rows = [
        f"ORIA {name} {_row(foreign.images.centre[k])} {_row(angles[k])} {cameras[foreign.images.camera[k]]}"
        for k, name in enumerate(images)
    ]
    rows += [f"CORD {name} {_row(place)}" for name, place in zip(points, foreign.points.coordinates, strict=True)]
    (path / "itera.dat").write_text("\n".join(rows) + "\n", encoding="utf-8")
    keys = ("principal_distance", "x0", "y0")
    rows = [
        f"CAPA {cameras[k]} {k + 1} {_row([element(c, key) for key in keys])}" for k, c in enumerate(foreign.cameras)
    ]
    position = dict(zip(foreign.points.names, points, strict=True))
    for row in foreign.control:
        if np.isfinite(row.coordinates).all():
            rows.append(f"{'CHCK' if row.check else 'CONT'} {position[row.name]} {_row(row.coordinates)}")
        else:
            losses.append(f"control point {row.name}, because one of its coordinates is unknown")
    (path / "geoin.dat").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return [*losses, "standard deviations", *losses_of_block(block, frozenset({"control"}))]


def _phi_omega_kappa(rotation: np.ndarray) -> np.ndarray:
    """Angles phi, omega, kappa in radians of R_y(phi) R_x(omega) R_z(kappa)."""
    omega = np.arcsin(np.clip(-rotation[:, 1, 2], -1, 1))
    phi = np.arctan2(rotation[:, 0, 2], rotation[:, 2, 2])
    kappa = np.arctan2(rotation[:, 1, 0], rotation[:, 1, 1])
    return np.column_stack([phi, omega, kappa])


def _row(values) -> str:
    return " ".join(f"{value:.12g}" for value in values)
