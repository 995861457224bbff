"""Reading and writing Bundler files, version 0.3: bundle.out, and list.txt with the names of the images.

    # Bundle file v0.3
    cameras points
    f k1 k2, R by rows, t                          for each camera; all 0 where it was not oriented
    X Y Z, r g b, rays (camera key x y) ...        for each point; x, y from the image centre, y up

p = R X + t, the camera looks along -z, x = f (1 + k1 r^2 + k2 r^4) (-p_x, -p_y) / p_z: the camera model `bal`.
Source: N. Snavely, Bundler 0.4 User's Manual.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.camera.forward import BAL, METASHAPE
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    ForeignBlock,
    ForeignCamera,
    Images,
    Points,
    RayTable,
    ReadOptions,
    element,
)
from jaxbundle.io.formats.source import MAX_NUMBER, lines_of, text_of, wrong
from jaxbundle.io.formats.written import in_pixels, losses_of_block
from jaxbundle.io.text_files import UnreadableError, file_bytes

HEAD = "# Bundle file v0.3"
FILES = ("bundle.out", "bundle/bundle.out", "bundle_final.out")
LISTS = ("list.txt", "../list.txt")
CUT = "the file is truncated or damaged: copy or export it again"


def _file(path: Path) -> Path | None:
    """The file bundle.out of a Bundler project."""
    if path.is_dir():
        return next((path / name for name in FILES if (path / name).is_file()), None)
    try:
        return path if file_bytes(path, len(HEAD)).startswith(b"# Bundle file") else None
    except UnreadableError:
        return None


def is_bundler(path: Path) -> bool:
    """Whether a path is a Bundler file, or a folder with bundle.out."""
    return _file(path) is not None


def read_bundler(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads cameras, points and rays of a Bundler file. Cameras that were not oriented have the orientation NaN.

    Raises: BlockError with the problem of the file.
    """
    file = _file(path) or path
    text = text_of(file)
    head, _, rest = text.partition("\n")
    if not head.startswith(HEAD):
        raise wrong(file, 1, f"the first line is not '{HEAD}'", "give a Bundler file of version 0.3")
    values = _values(file, rest)
    cameras, points = _counts(file, values)
    at = 2 + 15 * cameras
    if len(values) < at:
        raise wrong(file, 0, f"{cameras} cameras need {at - 2} numbers, the file has {len(values) - 2}", CUT)
    table = values[2:at].reshape(-1, 15)
    coordinates, rays = _points(file, values, at, (cameras, points))
    rotation, translation = table[:, 3:12].reshape(-1, 3, 3).copy(), table[:, 12:]
    rotation[table[:, 0] == 0] = np.nan
    back = np.swapaxes(rotation, 1, 2)
    centre = -(back @ translation[:, :, None])[:, :, 0]
    names = _names(file, cameras)
    size = options.image_size or (None, None)
    return ForeignBlock(
        format="Bundler file",
        name=path.resolve().stem if path.is_file() else path.resolve().name,
        cameras=tuple(
            ForeignCamera(
                f"camera of {name}",
                BAL,
                {"principal_distance": abs(float(f)) or 1.0, "k1": float(k1), "k2": float(k2)},
                BAL.elements,
                "px",
                *size,
            )
            for name, (f, k1, k2) in zip(names, table[:, :3], strict=True)
        ),
        images=Images(names, np.arange(cameras), back, centre),
        points=Points(tuple(map(str, range(points))), coordinates),
        rays=rays,
        arbitrary=True,
        assumptions=("image coordinates have a standard deviation of 1 px",),
    )


def _values(file: Path, text: str) -> Float[np.ndarray, " number"]:
    """All numbers of the file after its first line."""
    try:
        values = np.array(text.split(), float)
        if (np.abs(values) < MAX_NUMBER).all():
            return values
    except ValueError:
        pass
    for line, fields in enumerate(text.split("\n"), 2):
        for field in fields.split():
            try:
                good = abs(float(field)) < MAX_NUMBER
            except ValueError:
                good = False
            if not good:
                raise wrong(file, line, f"'{field[:40]}' is not a finite number")
    raise wrong(file, 0, "there are no numbers", CUT)


def _counts(file: Path, values: Float[np.ndarray, " number"]) -> tuple[int, int]:
    if len(values) < 2 or not (values[:2] > 0).all() or (values[:2] % 1).any() or (values[:2] > len(values)).any():
        raise wrong(file, 2, "the line does not give the numbers of cameras and points", CUT)
    return int(values[0]), int(values[1])


def _points(
    file: Path, values: Float[np.ndarray, " number"], at: int, counts: tuple[int, int]
) -> tuple[Float[np.ndarray, "point 3"], RayTable]:
    """Reads points and their rays; the length of a record depends on its number of rays."""
    cameras, points = counts
    starts, lengths = np.zeros(points, np.int64), np.zeros(points, np.int64)
    for k in range(points):
        count = values[at + 6] if at + 6 < len(values) else -1.0
        if count < 0 or count % 1 or at + 7 + 4 * count > len(values):
            raise wrong(
                file, 0, f"point {k} of {points} is incomplete: the file ends, or its number of rays is wrong", CUT
            )
        starts[k], lengths[k] = at, int(count)
        at += 7 + 4 * int(count)
    if at != len(values):
        raise wrong(file, 0, f"{len(values) - at} numbers follow the last point", CUT)
    coordinates = values[starts[:, None] + np.arange(3)]
    first = np.repeat(starts + 7, lengths) + 4 * (
        np.arange(lengths.sum()) - np.repeat(lengths.cumsum() - lengths, lengths)
    )
    image, x, y = (values[first + k] for k in (0, 2, 3))
    bad = np.flatnonzero(~((image >= 0) & (image < cameras) & (image % 1 == 0)))
    if len(bad):
        raise wrong(file, 0, f"{len(bad)} rays refer to a camera that does not exist, such as {image[bad[0]]:g}", CUT)
    return coordinates, RayTable(image.astype(np.int64), np.repeat(np.arange(points), lengths), np.column_stack([x, y]))


def _names(file: Path, cameras: int) -> tuple[str, ...]:
    """Names of the images from list.txt, else their numbers."""
    path = next((file.parent / name for name in LISTS if (file.parent / name).is_file()), None)
    if path is None:
        return tuple(map(str, range(cameras)))
    lines = [line.strip() for line in lines_of(path) if line.strip()]
    names = tuple(_without_focal(line) for line in lines)
    if len(names) != cameras:
        raise wrong(path, 0, f"{len(names)} images are listed, {file.name} has {cameras}", "give the list of this file")
    return names


def _without_focal(line: str) -> str:
    """A name without the two numbers that may follow it."""
    fields = line.rsplit(None, 2)
    return fields[0] if len(fields) == 3 and fields[1] == "0" else line


def write_bundler(block: Block, path: Path) -> list[str]:
    """Writes bundle.out and list.txt; coordinates are reduced by a shift, which is written to shift.txt.

    `path`: a folder, or a file with suffix .out. Returns: sentences about what the format cannot represent.
    """
    written = in_pixels(block, _holds)
    foreign, losses = written.foreign, list(written.losses)
    file = path if path.suffix else path / "bundle.out"
    file.parent.mkdir(parents=True, exist_ok=True)
    shift = np.round(foreign.images.centre.mean(0))
    shift = shift if np.abs(shift).max() > 10_000 else np.zeros(3)
    back = np.swapaxes(foreign.images.rotation, 1, 2)
    translation = -(back @ (foreign.images.centre - shift)[:, :, None])[:, :, 0]
    point = np.array([(element(c, "x0"), element(c, "y0")) for c in foreign.cameras])
    xy = (foreign.rays.xy - point[foreign.images.camera[foreign.rays.image]]) * [1, -1]
    lines = [HEAD, f"{len(back)} {len(foreign.points.names)}"]
    for k, camera in enumerate(foreign.images.camera.tolist()):
        one = foreign.cameras[camera]
        lines.append(_row([element(one, name) for name in ("principal_distance", "K1", "K2")]))
        lines += [_row(row) for row in back[k]]
        lines.append(_row(translation[k]))
    order = np.argsort(foreign.rays.point, kind="stable")
    ends = np.searchsorted(foreign.rays.point[order], np.arange(len(foreign.points.names) + 1))
    image = foreign.rays.image
    for k, place in enumerate(foreign.points.coordinates - shift):
        some = order[ends[k] : ends[k + 1]].tolist()
        rays = " ".join(f"{image[r]} {n} {xy[r, 0]:.17g} {xy[r, 1]:.17g}" for n, r in enumerate(some))
        lines += [_row(place), "128 128 128", f"{len(some)} {rays}"]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (file.parent / "list.txt").write_text("\n".join(foreign.images.names) + "\n", encoding="utf-8")
    if shift.any():
        (file.parent / "shift.txt").write_text(_row(shift) + "\n", encoding="utf-8")
        losses.append(f"coordinates are reduced by the shift {_row(shift)}, written to shift.txt")
    losses.append("the principal points: written image coordinates are relative to them")
    return [*losses, "names of points", *losses_of_block(block, frozenset())]


def _holds(camera: ForeignCamera) -> bool:
    """Whether a camera has only f, k1 and k2 in addition to its principal point."""
    others = set(camera.model.elements) - {"principal_distance", "x0", "y0", "K1", "K2", "y_axis"}
    return camera.model is METASHAPE and not any(element(camera, name) for name in others)


def _row(values) -> str:
    return " ".join(f"{value:.17g}" for value in values)
