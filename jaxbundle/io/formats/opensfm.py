"""Reading OpenSfM and OpenDroneMap: reconstruction.json and tracks.csv.

    f = focal max(W, H),  x0 = c_x max(W, H) + W/2,  y0 = c_y max(W, H) + H/2        tracks: the same unit and origin

Rotation vectors and translations are image from object. From several reconstructions the one with the maximum number of
images is read.
Source: OpenSfM's documentation, "Dataset structure" and "Camera models".
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, RootModel

from jaxbundle.block.findings import Finding, Kind, Severity
from jaxbundle.block.problems import BlockError, Problem, shown
from jaxbundle.camera.forward import METASHAPE
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import (
    DEFAULT,
    ForeignBlock,
    ForeignCamera,
    Images,
    Points,
    RayTable,
    ReadOptions,
)
from jaxbundle.io.formats.source import json_of, require_lengths, text_of, validated, wrong
from jaxbundle.io.noted import Noted

FILE, TRACKS = "reconstruction.json", "tracks.csv"
VERSION = "OPENSFM_TRACKS_VERSION_"
COLUMNS = (8, 9, 10, 11, 12)  # columns of tracks.csv of each version
TANGENTIAL = {"p1": "P2", "p2": "P1"}  # coefficients of OpenCV
RADIAL = {"k1": "K1", "k2": "K2", "k3": "K3"}


class _Loose(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


Triple = tuple[float, float, float]


class _Camera(_Loose):
    projection_type: str
    width: int = Field(gt=0, lt=10**8)
    height: int = Field(gt=0, lt=10**8)
    focal: float | None = None
    focal_x: float | None = None
    focal_y: float | None = None
    c_x: float = 0.0
    c_y: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class _Shot(_Loose):
    rotation: Triple
    translation: Triple
    camera: str
    gps_position: Triple | None = None
    gps_dop: float | None = None


class _Point(_Loose):
    coordinates: Triple


class _Reconstruction(_Loose):
    cameras: dict[str, _Camera]
    shots: dict[str, _Shot]
    points: dict[str, _Point] = {}
    reference_lla: dict[str, float] | None = None


class _File(RootModel):
    root: list[_Reconstruction]


class _Parts(NamedTuple):
    cameras: tuple[str, ...]
    terms: dict[str, str]


_TYPES = {
    "perspective": _Parts(("focal",), {"k1": "K1", "k2": "K2"}),
    "brown": _Parts(("focal_x", "focal_y"), {**RADIAL, **TANGENTIAL}),
    "simple_radial": _Parts(("focal_x", "focal_y"), {"k1": "K1"}),
    "radial": _Parts(("focal_x", "focal_y"), {"k1": "K1", "k2": "K2"}),
}


def is_opensfm(path: Path) -> bool:
    """Whether a folder contains a reconstruction of OpenSfM, or a folder opensfm with one, as OpenDroneMap writes."""
    return path.is_dir() and any((folder / FILE).is_file() for folder in (path, path / "opensfm"))


def read_opensfm(path: Path, options: ReadOptions = DEFAULT) -> ForeignBlock:
    """Reads the largest reconstruction of a folder and its tracks.

    Raises: BlockError with all problems.
    """
    folder = path if (path / FILE).is_file() else path / "opensfm"
    content = json_of(folder / FILE)
    reconstructions = validated(folder / FILE, _File, content).root
    if not reconstructions:
        raise wrong(folder / FILE, 0, "there is no reconstruction", "run the reconstruction again")
    if not (folder / TRACKS).is_file():
        raise BlockError(
            [Problem(f"{TRACKS} is missing in the folder of {FILE}", "add the tracks: they contain the rays")]
        )
    chosen = max(reconstructions, key=lambda one: len(one.shots))
    cameras = _cameras(folder / FILE, _of_size(chosen, options.image_size))
    findings = []
    if len(reconstructions) > 1:
        others = sum(len(one.shots) for one in reconstructions) - len(chosen.shots)
        what = f"{FILE} has {len(reconstructions)} reconstructions; the largest was read, {others} images are not"
        findings.append(Finding(Kind.UNUSED, what, grade=Severity.CHECK))
    names = tuple(chosen.shots)
    vectors = np.array([shot.rotation for shot in chosen.shots.values()]).reshape(-1, 3)
    translations = np.array([shot.translation for shot in chosen.shots.values()]).reshape(-1, 3)
    require_lengths(folder / FILE, "translations", translations)
    turned, centres = rotations.from_camera(rotations.from_vectors(vectors), translations)
    position = {name: k for k, name in enumerate(cameras)}
    camera = np.array([position[shot.camera] for shot in chosen.shots.values()], np.int64)
    points = Points(
        tuple(chosen.points), np.array([point.coordinates for point in chosen.points.values()]).reshape(-1, 3)
    )
    sizes = np.array([(cameras[shot.camera].width, cameras[shot.camera].height) for shot in chosen.shots.values()])
    rays, found = _rays(folder / TRACKS, names, points.names, sizes.reshape(-1, 2).astype(float))
    reference = chosen.reference_lla
    system = ""
    if reference and {"latitude", "longitude"} <= reference.keys():
        place = " ".join(f"{reference[key]:.9f}" for key in ("latitude", "longitude"))
        system = f"topocentric about latitude and longitude {place} (WGS 84)"
    return ForeignBlock(
        format="OpenSfM reconstruction",
        name=path.resolve().name,
        cameras=tuple(cameras.values()),
        images=Images(names, camera, turned, centres),
        points=points,
        rays=rays,
        coordinate_system=system,
        arbitrary=True,
        assumptions=("image coordinates have a standard deviation of 1 px",),
        findings=(*findings, *found),
    )


def _of_size(chosen: _Reconstruction, size: tuple[int, int] | None) -> _Reconstruction:
    """The reconstruction with the true size of its images: OpenDroneMap writes the size of reduced ones."""
    if size is None:
        return chosen
    scaled = {"width": size[0], "height": size[1]}
    cameras = {name: camera.model_copy(update=scaled) for name, camera in chosen.cameras.items()}
    return chosen.model_copy(update={"cameras": cameras})


def _cameras(path: Path, chosen: _Reconstruction) -> dict[str, ForeignCamera]:
    noted, cameras = Noted(), {}
    for name, camera in chosen.cameras.items():
        parts = _TYPES.get(camera.projection_type)
        if parts is None:
            what = f"camera {shown(name)} has the projection {shown(camera.projection_type)}"
            noted.add(path.name, 0, what, f"read are {', '.join(_TYPES)}; undistort the images in OpenSfM")
            continue
        size = max(camera.width, camera.height)
        focal = camera.focal if camera.focal is not None else camera.focal_y
        focal_x = focal if camera.focal_x is None or camera.focal is not None else camera.focal_x
        if focal is None or focal_x is None:
            noted.add(path.name, 0, f"camera {shown(name)} has no {' and '.join(parts.cameras)}", "add it")
            continue
        elements = {
            "principal_distance": focal * size,
            "x0": camera.c_x * size + camera.width / 2,
            "y0": camera.c_y * size + camera.height / 2,
            "b1": (focal_x - focal) * size,
        }
        elements |= {ours: getattr(camera, theirs) for theirs, ours in parts.terms.items()}
        full = ("x0", "y0", "b1") if len(parts.cameras) == 2 else ()
        estimate = ("principal_distance", *full, *parts.terms.values())
        cameras[name] = ForeignCamera(name, METASHAPE, elements, estimate, "px", camera.width, camera.height)
    for name, shot in chosen.shots.items():
        if shot.camera not in chosen.cameras:
            noted.add(
                path.name, 0, f"image {shown(name)} has the camera {shown(shot.camera)}, which is missing", "add it"
            )
    if noted:
        raise noted.error()
    return cameras


def _rays(
    path: Path, images: tuple[str, ...], points: tuple[str, ...], sizes: Float[np.ndarray, "image 2"]
) -> tuple[RayTable, tuple[Finding, ...]]:
    """Rays of existing images and points; the others are counted."""
    text = text_of(path)
    head, _, rest = text.partition("\n")
    text = rest if head.startswith(VERSION) else text
    columns = len(text.partition("\n")[0].split("\t"))
    if columns not in COLUMNS:
        raise wrong(path, 2, f"the row has {columns} fields, not shot, track, feature, x, y and others, by tabs")
    try:
        names = [str(k) for k in range(columns)]
        table = pl.read_csv(
            text.encode(), separator="\t", has_header=False, new_columns=names, infer_schema=False, quote_char=None
        )
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise wrong(path, 0, f"the table cannot be read: {shown(str(error))}") from error
    xy = table.select(pl.col("3", "4").cast(pl.Float64, strict=False)).to_numpy()
    bad = np.flatnonzero(~(np.abs(np.nan_to_num(xy, nan=np.inf)) < 1e6).all(1))
    if len(bad):
        line = int(bad[0]) + 1 + (rest is text)
        raise wrong(path, line, f"{len(bad)} rows have no finite image coordinates, the first here")
    image, point = (_positions(table[column], given) for column, given in (("0", images), ("1", points)))
    known = (image >= 0) & (point >= 0)
    image, point, xy = image[known], point[known], xy[known]
    coordinates = xy * sizes.max(1)[image][:, None] + sizes[image] / 2 if len(image) else xy
    findings = ()
    if not known.all():
        what = f"{int((~known).sum())} of {len(known)} rows of {path.name} belong to images or points that were not"
        findings = (Finding(Kind.UNUSED, f"{what} reconstructed", grade=Severity.NOTE),)
    return RayTable(image, point, coordinates), findings


def _positions(names: pl.Series, given: tuple[str, ...]) -> np.ndarray:
    """Indices of names among the given ones, -1 for a missing name."""
    known = pl.DataFrame({"name": pl.Series(given, dtype=pl.String), "at": np.arange(len(given))})
    joined = names.alias("name").to_frame().join(known, on="name", how="left", maintain_order="left")
    return joined["at"].fill_null(-1).to_numpy().astype(np.int64)
