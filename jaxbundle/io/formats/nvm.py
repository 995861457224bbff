"""Reading and writing NVM files of VisualSFM and of other programs, such as COLMAP.

    NVM_V3 [FixedK fx cx fy cy r]
    n, then n times    name f qw qx qy qz Cx Cy Cz d 0
    m, then m times    X Y Z r g b rays (image feature x y) ...

Quaternions are image from object, C is the projection centre. There are two dialects: VisualSFM counts image
coordinates from the image centre, and d corrects the measurement, (1 + d r^2 / f^2) m; COLMAP writes coordinates from
the corner and d = -k of a distortion of the projection. A negative coordinate indicates the first dialect; the rays
decide on d. Source: Changchang Wu, VisualSFM, "NVM file format"; COLMAP, src/colmap/scene/reconstruction_io.cc.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.camera.brown import BROWN
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.bundler import CUT
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    Alternative,
    ForeignBlock,
    ForeignCamera,
    Images,
    Points,
    RayTable,
    ReadOptions,
    element,
)
from jaxbundle.io.formats.source import lines_of, numbers, wrong
from jaxbundle.io.formats.written import in_pixels, is_free, losses_of_block
from jaxbundle.io.noted import Noted
from jaxbundle.io.text_files import UnreadableError, file_bytes

HEAD = "NVM_V3"


def is_nvm(path: Path) -> bool:
    """Whether a file begins like one of VisualSFM."""
    try:
        return not path.is_dir() and file_bytes(path, len(HEAD)) == HEAD.encode()
    except UnreadableError:
        return False


def read_nvm(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the first model of an NVM file.

    Raises: BlockError with all problems.
    """
    noted, lines = Noted(), [(k, line.strip()) for k, line in enumerate(lines_of(path), 1)]
    rows = [(k, line) for k, line in lines[1:] if line and not line.startswith("#")]
    cameras, at = _count(path, rows, 0, "images")
    names, table = [], np.full((cameras, 9), np.nan)
    for k, (line, text) in enumerate(rows[1 : cameras + 1]):
        fields = text.rsplit(None, 10)
        values = numbers(path, line, fields[1:], noted) if len(fields) == 11 else None
        if len(fields) != 11:
            noted.add(path.name, line, f"the image has {len(fields)} fields, not name and ten numbers", CUT)
        if values is not None:
            names.append(fields[0].strip('"'))
            table[k] = values[:9]
    points, at = _count(path, rows, cameras + 1, "points")
    found = [_point(path, line, text, cameras, noted) for line, text in rows[at : at + points]]
    if noted:
        raise noted.error()
    if len(found) != points:
        raise wrong(path, rows[-1][0], f"there are {len(found)} points, not {points}", CUT)
    rest = rows[at + points :]
    turned, centre = rotations.from_quaternions(table[:, 1:5]), table[:, 5:8]
    rays = np.concatenate([ray for _, ray in found if ray is not None] or [np.zeros((0, 4))])
    counts = [0 if ray is None else len(ray) for _, ray in found]
    centred = bool((rays[:, 2:] < 0).any())
    size = _size(path, rays, centred, options)
    xy = rays[:, 2:] + (np.array(size) / 2 if centred else 0.0)
    findings = ()
    if rest and rest[0][1] != "0":
        what = f"{path.name} has further models, which are not read"
        findings = (Finding(Kind.UNUSED, what, grade=Severity.CHECK),)
    d = table[:, 8]
    foreign = ForeignBlock(
        format="NVM file (VisualSFM)" if centred else "NVM file",
        name=path.resolve().stem,
        cameras=_corrected(names, table, d, size),
        images=Images(tuple(names), np.arange(cameras), np.swapaxes(turned, 1, 2) @ rotations.DOWN_FORWARD, centre),
        points=Points(tuple(map(str, range(points))), np.array([xyz for xyz, _ in found]).reshape(-1, 3)),
        rays=RayTable(rays[:, 0].astype(np.int64), np.repeat(np.arange(points), counts), xy),
        arbitrary=True,
        assumptions=("image coordinates have a standard deviation of 1 px",),
        findings=findings,
    )
    if not d.any():
        return foreign
    other = _distorted(names, table, d, size)
    return dataclasses.replace(
        foreign,
        reading="with d as a correction of the measurement",
        alternatives=(
            Alternative("with -d as a distortion of the projection", lambda f: dataclasses.replace(f, cameras=other)),
        ),
    )


def _count(path: Path, rows: list[tuple[int, str]], at: int, what: str) -> tuple[int, int]:
    if at >= len(rows):
        raise wrong(path, rows[-1][0] if rows else 1, f"the file ends before the number of {what}", CUT)
    line, text = rows[at]
    if not (text.isascii() and text.isdigit() and 0 < int(text[:9]) and len(text) < 10):
        raise wrong(path, line, f"'{text[:40]}' is not the number of {what}", CUT)
    return int(text), at + 1


def _point(
    path: Path, line: int, text: str, images: int, noted: Noted
) -> tuple[list[float], Float[np.ndarray, "ray 4"] | None]:
    fields = text.split()
    values = numbers(path, line, fields, noted)
    if values is None:
        return [np.nan] * 3, None
    if len(values) < 7 or len(values) != 7 + 4 * values[6]:
        noted.add(path.name, line, f"the point has {len(values)} numbers, not 7 and 4 for each ray", CUT)
        return [np.nan] * 3, None
    rays = np.array(values[7:]).reshape(-1, 4)
    if not ((rays[:, 0] >= 0) & (rays[:, 0] < images) & (rays[:, 0] % 1 == 0)).all():
        noted.add(path.name, line, f"a ray refers to a missing image: there are {images}, numbered from 0", CUT)
        return [np.nan] * 3, None
    return values[:3], rays


def _size(path: Path, rays: Float[np.ndarray, "ray 4"], centred: bool, options: ReadOptions) -> tuple[int, int]:
    """Width and height of the images, which are not in the file."""
    if options.image_size:
        return options.image_size
    if centred:  # the origin is then arbitrary: the extent of the rays is sufficient
        extent = 2 * np.ceil(np.abs(rays[:, 2:]).max(0))
        return int(extent[0]), int(extent[1])
    what = f"{path.name} has image coordinates from the corner, and NVM files do not have the size of the images"
    raise BlockError([Problem(what, "give it with --image-size W,H")])


def _corrected(
    names: list[str], table: Float[np.ndarray, "image 9"], d: Float[np.ndarray, " image"], size: tuple[int, int]
) -> tuple[ForeignCamera, ...]:
    """Cameras in which d corrects the measurement: K1 = d / f^2 of `brown`."""
    return tuple(
        ForeignCamera(
            f"camera of {name}",
            BROWN if d.any() else METASHAPE,
            {"principal_distance": abs(f) or 1.0, "x0": size[0] / 2, "y0": size[1] / 2, "K1": k / (f * f or 1.0)},
            ("principal_distance", "K1") if d.any() else ("principal_distance",),
            "px",
            *size,
        )
        for name, f, k in zip(names, table[:, 0].tolist(), d.tolist(), strict=True)
    )


def _distorted(
    names: list[str], table: Float[np.ndarray, "image 9"], d: Float[np.ndarray, " image"], size: tuple[int, int]
) -> tuple[ForeignCamera, ...]:
    """Cameras in which -d distorts the projection: K1 = -d for c = 1."""
    return tuple(
        ForeignCamera(
            f"camera of {name}",
            METASHAPE,
            {"principal_distance": abs(f) or 1.0, "x0": size[0] / 2, "y0": size[1] / 2, "K1": -k},
            ("principal_distance", "K1"),
            "px",
            *size,
        )
        for name, f, k in zip(names, table[:, 0].tolist(), d.tolist(), strict=True)
    )


def write_nvm(block: Block, path: Path) -> list[str]:
    """Writes an NVM file of VisualSFM without distortion, with image coordinates from the principal point.

    Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, is_free)
    foreign = written.foreign
    images, rays = foreign.images, foreign.rays
    turned, _ = rotations.to_camera(images.rotation, images.centre)
    poses = np.concatenate([rotations.to_quaternions(turned), images.centre], 1)
    lines = [HEAD, "", str(len(poses))]
    for name, camera, pose in zip(images.names, images.camera.tolist(), poses, strict=True):
        f = element(foreign.cameras[camera], "principal_distance")
        lines.append(f"{name}\t{_row([f, *pose])} 0 0")
    point = np.array([(element(c, "x0"), element(c, "y0")) for c in foreign.cameras])
    xy = rays.xy - point[images.camera[rays.image]]
    lines += ["", str(len(foreign.points.names))]
    order = np.argsort(rays.point, kind="stable")
    ends = np.searchsorted(rays.point[order], np.arange(len(foreign.points.names) + 1))
    for k, place in enumerate(foreign.points.coordinates):
        some = order[ends[k] : ends[k + 1]].tolist()
        told = " ".join(f"{rays.image[r]} {n} {xy[r, 0]:.17g} {xy[r, 1]:.17g}" for n, r in enumerate(some))
        lines.append(f"{_row(place)} 128 128 128 {len(some)} {told}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*lines, "", "0", ""]), encoding="utf-8")
    losses = ["the principal points: written image coordinates are relative to them", "names of points"]
    return [*written.losses, *losses, *losses_of_block(block, frozenset())]


def _row(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)
