"""BAL text files (Agarwal, Snavely, Seitz, Szeliski 2010: Bundle Adjustment in the Large).

    cameras points observations
    camera point x y                            one line per observation, px, origin in the image centre, y up
    rotation vector, t, f, k1, k2               nine numbers per camera, p = R X + t
    X Y Z                                       three numbers per point

Each image has its own camera. The projection centre is X0 = -R^T t; its angles are those of R^T,
object_from_image.
"""

import codecs
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
from jaxtyping import Array, Float

from jaxbundle.block.block import Block, Camera, CheckPoints, ExteriorOrientation, InteriorOrientation, Rays, Structure
from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.camera.forward import BAL
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import OMEGA_PHI_KAPPA
from jaxbundle.io.noted import measured_again
from jaxbundle.io.ranges import (
    MAX_COEFFICIENT,
    MAX_IMAGE_COORDINATE,
    MAX_LENGTH,
    NOTHING,
    PRINCIPAL_DISTANCES,
    TURNS,
)
from jaxbundle.io.text_files import require_bytes
from jaxbundle.numerics.host import on_device

HEAD = 200  # characters that contain the first line
FIELD = re.compile(rb"(?<!\S)(?![+-]?\d{1,17}(?:\.\d{0,30})?(?:[eE][+-]?\d{1,2})?(?!\S))\S+")  # not a plain number
DIGITS = 18  # of the numbers of cameras, points and observations: they fit into 64 bits
AGAIN = "correct it, or download the file again"
SHOWN_FIELDS = 10  # of a line in a message
Numbers = Float[np.ndarray, " number"]


def read_bal(path: str | Path, estimate_interior: bool = True) -> Block:
    """The block of a BAL file: names are numbers, sigmas are 1 px; points behind a camera are not changed.

    `estimate_interior`: f, k1, k2 of each camera are unknown, otherwise fixed.

    Raises: BlockError with all problems of the file.

    Example:
        >>> jb.io.write_bal(bal, "small.txt")
        >>> jb.io.read_bal("small.txt")
        <Block small: 3 images, 5 points, 15 rays, 3 cameras>
    """
    text = _plain(require_bytes(Path(path)))
    cameras, points, observations = _counts(Path(path).name, text)
    numbers = _numbers(Path(path).name, text, 3 + 4 * observations + 9 * cameras + 3 * points)
    rays, parameters, coordinates = np.split(numbers[3:], [4 * observations, 4 * observations + 9 * cameras])
    rays, parameters = rays.reshape(-1, 4), parameters.reshape(-1, 9)
    _require_indices(Path(path).name, text, rays, cameras, points)
    _require_sizes(Path(path).name, text, numbers[3:], cameras, observations)
    centre, angles = _orientation(parameters[:, :6].T)
    names = tuple(map(str, range(cameras)))
    structure = Structure(
        name=Path(path).stem,
        cameras=tuple(Camera(name, BAL) for name in names),
        image_names=names,
        point_names=tuple(map(str, range(points))),
        image_camera=np.arange(cameras, dtype=np.int32),
        ray_image=rays[:, 0].astype(np.int32),
        ray_point=rays[:, 1].astype(np.int32),
        exterior_free=np.ones((cameras, 6), bool),
        interior_free=np.full((cameras, 3), estimate_interior),
        point_free=np.ones((points, 3), bool),
        check_point=np.zeros(0, np.int32),
        findings=_measured_again(rays, points),
    )
    return Block(
        structure,
        ExteriorOrientation(centre.T, angles.T),
        InteriorOrientation(on_device(parameters[:, 6:])),
        on_device(coordinates.reshape(-1, 3)),
        Rays(on_device(rays[:, 2:]), on_device(np.ones((observations, 2)))),
        (),
        CheckPoints(*(on_device(np.zeros((0, 3))) for _ in range(2))),
    )


def _plain(text: bytes) -> bytes:
    """The text without byte order mark, with LF at the end of each line."""
    text = text.removeprefix(codecs.BOM_UTF8)
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text


def is_bal(head: bytes) -> bool:
    """Whether a file with this beginning is a BAL file: three integers in its first line."""
    fields = _plain(head).partition(b"\n")[0].split()
    return len(fields) == 3 and all(field.isdigit() and len(field) <= DIGITS for field in fields)


def _measured_again(rays: Float[np.ndarray, "ray 4"], points: int) -> tuple[Finding, ...]:
    """The finding that names points measured more than once on an image: all of their rays are observations."""
    pairs = rays[:, 0].astype(np.int64) * points + rays[:, 1].astype(np.int64)
    _, first = np.unique(pairs, return_index=True)
    if len(first) == len(pairs):
        return ()
    again = np.ones(len(pairs), bool)
    again[first] = False
    return (measured_again([(f"{image:.0f}", f"{point:.0f}") for image, point in rays[again, :2].tolist()]),)


def _wrong(file: str, line: int, what: str, cure: str) -> BlockError:
    problem = Problem(what, cure, file)
    return BlockError([problem], [f"{file}:{line}: {what}; {cure}"])


def _counts(file: str, text: bytes) -> tuple[int, int, int]:
    head = text[:HEAD]
    if not is_bal(head):
        what = "the first line does not give the numbers of cameras, points and observations"
        raise _wrong(file, 1, what, "begin the file with three integers")
    cameras, points, observations = map(int, head.partition(b"\n")[0].split())
    if 0 in (cameras, points, observations):
        what = f"{cameras} cameras, {points} points and {observations} observations are not a block"
        raise _wrong(file, 1, what, "give at least one of each")
    return cameras, points, observations


def _numbers(file: str, text: bytes, promised: int) -> Numbers:
    """All numbers of the file, in their order."""
    try:
        numbers = np.fromstring(text, sep=" ")
    except ValueError:
        numbers = None
    readable = numbers is not None and bool(np.isfinite(numbers).all())
    if numbers is None or not readable or len(numbers) != promised:
        raise _what_is_wrong(file, text, promised, readable)
    return numbers


def _what_is_wrong(file: str, text: bytes, promised: int, readable: bool) -> BlockError:
    """Index of the first wrong field: not a number, or in an incomplete observation; else the number of fields."""
    cameras, points, observations = _counts(file, text)
    wrong = None if readable else next((field for field in FIELD.finditer(text) if not _is_finite(field[0])), None)
    if wrong:
        line = text.count(b"\n", 0, wrong.start()) + 1
        said = shown(wrong[0].decode(errors="replace"))
        return _wrong(file, line, f"'{said}' is not a finite number", AGAIN)
    lines = [(number, line.split()) for number, line in enumerate(text.split(b"\n"), 1) if line.strip()]
    for number, fields in lines[1 : observations + 1]:
        if len(fields) != 4:
            said = shown(b" ".join(fields[:SHOWN_FIELDS]).decode(errors="replace"))
            return _wrong(file, number, f"observation '{said}' has {len(fields)} numbers, not 4", AGAIN)
    found = sum(len(fields) for _, fields in lines)
    promise = f"{cameras} cameras, {points} points and {observations} observations need {promised} numbers"
    cure = "the file is truncated: download it again" if found < promised else "correct the first line"
    return _wrong(file, lines[-1][0], f"{promise}, the file has {found}", cure)


def _is_finite(field: bytes) -> bool:
    try:
        return b"_" not in field and bool(np.isfinite(float(field)))
    except ValueError:
        return False


def _require_indices(file: str, text: bytes, rays: Float[np.ndarray, "ray 4"], cameras: int, points: int) -> None:
    """Raises BlockError for the first observation of a camera or point that does not exist."""
    for column, (what, count) in enumerate((("camera", cameras), ("point", points))):
        index = rays[:, column]
        wrong = np.flatnonzero(~((index >= 0) & (index < count) & (index == np.floor(index))))
        if len(wrong):
            line = _line(text, 3 + 4 * int(wrong[0]) + column)
            problem = f"there is no {what} {index[wrong[0]]:g}: the file has {count}, numbered from 0"
            raise _wrong(file, line, problem, "correct the number, or drop the observation and correct the first line")


def _require_sizes(file: str, text: bytes, numbers: Numbers, cameras: int, observations: int) -> None:
    """Raises BlockError for the first number that is outside the range of its quantity."""
    ends = 4 * observations, 4 * observations + 9 * cameras
    limits = np.full(len(numbers), MAX_LENGTH)
    limits[: ends[0]] = MAX_IMAGE_COORDINATE
    rows = limits[ends[0] : ends[1]].reshape(-1, 9)
    rows[:, :3], rows[:, 6], rows[:, 7:] = TURNS * 2 * np.pi, PRINCIPAL_DISTANCES[1], MAX_COEFFICIENT
    size = np.abs(numbers)
    smallest = np.zeros(len(numbers))
    smallest[ends[0] : ends[1]].reshape(-1, 9)[:, 6] = PRINCIPAL_DISTANCES[0]
    wrong = np.flatnonzero((size > limits) | (size < smallest) | ((size < NOTHING) & (size > 0)))
    if len(wrong):
        k = int(wrong[0])
        bounds = f"not from {smallest[k]:g} to {limits[k]:g} in size, as {_meaning(k, ends)} is"
        others = len(wrong) - 1
        more = f", and {others} more {'number is' if others == 1 else 'numbers are'} out of range" if others else ""
        raise _wrong(file, _line(text, 3 + k), f"{numbers[k]:g} is {bounds}{more}", AGAIN)


def _meaning(k: int, ends: tuple[int, int]) -> str:
    """Quantity of the k-th number after the first line, in words."""
    if k < ends[0]:
        return ("the number of a camera", "the number of a point", "an image coordinate", "an image coordinate")[k % 4]
    if k < ends[1]:
        element = (k - ends[0]) % 9
        names = ("a rotation vector, rad", "a translation", "f", "k1", "k2")
        return names[(0, 0, 0, 1, 1, 1, 2, 3, 4)[element]]
    return "a coordinate"


def _line(text: bytes, field: int) -> int:
    """Line of a field, both counted over the whole file: lines from 1, fields from 0."""
    last = np.cumsum([len(line.split()) for line in text.split(b"\n")])
    return int(np.searchsorted(last, field, side="right")) + 1


@jax.jit
def _orientation(parameters: Float[Array, "6 image"]) -> tuple[Float[Array, "3 image"], Float[Array, "3 image"]]:
    """Projection centres and angles from rotation vectors and translations."""
    x, y, z, *t = parameters
    object_from_image = rotation.transpose(rotation.from_rotation_vector(x, y, z))
    centre = -jnp.stack(rotation.apply(object_from_image, (t[0], t[1], t[2])))
    return centre, jnp.stack(OMEGA_PHI_KAPPA.angles_from_rotation(object_from_image))


def write_bal(block: Block, path: str | Path) -> None:
    """Writes images, points and rays; the format has no sigmas, no control and no fixed unknowns.

    Raises: BlockError where a camera has a model other than `bal`.

    Example:
        >>> jb.io.write_bal(bal, "small.txt")
        >>> Path("small.txt").read_text().split()[:3]
        ['3', '5', '15']
    """
    require_a(Block, block, "io.write_bal")
    structure = block.structure
    problems = [
        Problem(f"camera {camera.name} has the model '{camera.model.name}'", "BAL files support the model 'bal' only")
        for camera in structure.cameras
        if camera.model is not BAL
    ]
    if problems:
        raise BlockError(problems)
    interior = np.asarray(block.interior.elements)[structure.image_camera]
    parameters = np.concatenate([_rotation_and_translation(block), interior], 1)
    x, y = np.asarray(block.rays.coordinates).T
    rays = pl.DataFrame({"image": structure.ray_image, "point": structure.ray_point, "x": x, "y": y})
    numbers = pl.DataFrame({"number": np.concatenate([parameters.ravel(), np.asarray(block.object_points).ravel()])})
    with Path(path).open("wb") as file:
        file.write(f"{len(structure.image_names)} {len(structure.point_names)} {len(x)}\n".encode())
        rays.write_csv(file, include_header=False, separator=" ")
        numbers.write_csv(file, include_header=False)


def _rotation_and_translation(block: Block) -> Float[np.ndarray, "image 6"]:
    object_from_image = block.structure.rotation_system.rotation_from_angles(*block.exterior.angles.T)
    image_from_object = rotation.transpose(object_from_image)
    x0, y0, z0 = block.exterior.projection_centre.T
    translation = -jnp.stack(rotation.apply(image_from_object, (x0, y0, z0)))
    return np.asarray(jnp.concatenate([jnp.stack(rotation.to_rotation_vector(image_from_object)), translation]).T)
