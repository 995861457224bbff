"""Every way to break the fiducials of a folder, and what the user is told."""

from collections.abc import Callable
from pathlib import Path

import pytest
from cases.scanned_film import film_folder
from cases.small_folder import append, change, write

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read_block_folder

Edit = Callable[[Path], object]


def without(file: str, *starts: str) -> Edit:
    def edit(folder: Path) -> None:
        rows = (folder / file).read_text().splitlines()
        write(folder, file, rows[0], [row for row in rows[1:] if not row.startswith(starts)])

    return edit


def toml(old: str, new: str) -> Edit:
    def edit(folder: Path) -> None:
        text = (folder / "block.toml").read_text()
        assert old in text
        (folder / "block.toml").write_text(text.replace(old, new, 1))

    return edit


def row(file: str, line: int, old: str, new: str) -> Edit:
    return lambda folder: change(folder, file, line, old, new)


WORDS: dict[str, tuple[Edit, str]] = {
    "too few": (
        without("fiducial_rays.csv", *(f"012,{n}" for n in "345678")),
        "fiducial_rays.csv:10: image 012 has 2 fiducials, too few for the affine transformation; "
        "measure at least 3, better 4",
    ),
    "none": (
        without("fiducial_rays.csv", "012"),
        "images.csv:3: image 012 has 0 fiducials, too few for the affine transformation; measure at least 3, better 4",
    ),
    "collinear": (
        without("fiducial_rays.csv", *(f"021,{n}" for n in "4678")),
        "fiducial_rays.csv:18: the fiducials of image 021 do not determine the projective transformation: "
        "they lie three on one line; measure others, or correct their coordinates",
    ),
    "unknown fiducial": (
        row("fiducial_rays.csv", 11, "012,2", "012,9"),
        "fiducial_rays.csv:11: fiducial 9 on image 012: camera wide has no fiducial 9 in fiducials.csv; "
        "add it there, correct the name or drop the row",
    ),
    "unknown image": (
        row("fiducial_rays.csv", 11, "012,2", "013,2"),
        "fiducial_rays.csv:11: fiducial 2 on image 013: image 013 is not in images.csv; "
        "add it there, correct the name or drop the row",
    ),
    "fiducial without name": (
        row("fiducial_rays.csv", 11, "012,2", "012,"),
        "fiducial_rays.csv:11: fiducial  on image 012: the fiducial has no name; add the name or drop the row",
    ),
    "measured twice": (
        row("fiducial_rays.csv", 11, "012,2", "012,1"),
        "fiducial_rays.csv:11: fiducial 1 on image 012: is already in line 10; drop one of the two",
    ),
    "unknown camera": (
        row("fiducials.csv", 4, "wide", "narrow"),
        "fiducials.csv:4: fiducial 3 of camera narrow: camera narrow is not in block.toml; known: wide; "
        "add it there, correct the name or drop the row",
    ),
    "calibrated twice": (
        row("fiducials.csv", 4, "wide,3", "wide,2"),
        "fiducials.csv:4: fiducial 2 of camera wide: is already in line 3; drop one of the two",
    ),
    "no number": (
        row("fiducials.csv", 2, "wide,1,-", "wide,1,x"),
        "fiducials.csv:2: fiducial 1 of camera wide: x is 'x",
    ),
    "camera without fiducials": (
        toml('fiducials = "projective"\n', ""),
        "fiducials.csv:2: fiducial 1 of camera wide: camera wide has no fiducials in block.toml; "
        'give it fiducials = "affine" there, or drop its rows',
    ),
    "no table": (
        toml('fiducial_rays = "fiducial_rays.csv"\n', ""),
        "block.toml:21: [cameras.wide] fiducials need the table fiducial_rays; name it in [tables], or drop fiducials",
    ),
    "unknown transformation": (
        toml('"projective"', '"helmert"'),
        "block.toml:21: [cameras.wide] fiducials 'helmert' are unknown; known: conformal, affine, projective",
    ),
    "no pixel size": (
        toml("pixel_size = 0.01\n", ""),
        "block.toml:20: [cameras.wide] fiducials need pixel_size; give the nominal pixel of the scan in mm",
    ),
    "rays in mm": (
        toml('image_unit = "px"\npixel_size = 0.01', 'image_unit = "mm"'),
        "block.toml:20: [cameras.wide] rays in mm need no fiducials; "
        'drop them, or give the rays in px and image_unit = "px"',
    ),
    "camera in px": (
        lambda folder: [toml("pixel_size = 0.01\n", "")(folder), toml('"none"', '"metashape"')(folder)],
        "block.toml:20: [cameras.wide] distortion 'metashape' is for rays in px, but fiducials transform them to mm; "
        "use another distortion",
    ),
    "grid base": (
        toml('"none"', '"ebner"\ncoefficients = { grid_base = 0.0 }'),
        "block.toml:20: [cameras.wide] grid_base is 0.0; give a positive number",
    ),
    "no grid base": (
        toml('height = 3600\nprincipal_distance = 50.0\nprincipal_point = [0.1, -0.2]\ndistortion = "none"',
             'principal_distance = 50.0\nprincipal_point = [0.1, -0.2]\ndistortion = "gruen"'),
        "block.toml:12: [cameras.wide] distortion 'gruen' needs grid_base; "
        "add it to the coefficients: 0.4 of the longer side of the image is usual",
    ),
}  # fmt: skip
AFFINE = ("too few", "none")
FOLLOWS = ("unknown camera", "calibrated twice", "no number")  # more is told: those of measured fiducials that lack it


@pytest.mark.parametrize("name", WORDS)
def test_what_is_wrong_with_fiducials_is_told(tmp_path: Path, name: str) -> None:
    edit, expected = WORDS[name]
    folder = film_folder(tmp_path / "small", "affine" if name in AFFINE else "projective")
    edit(folder)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert [line for line in caught.value.lines if line.startswith(expected)], "\n".join(caught.value.lines)
    assert len(caught.value.lines) == 1 or name in FOLLOWS, "\n".join(caught.value.lines)


def test_everything_is_told_at_once(tmp_path: Path) -> None:
    folder = film_folder(tmp_path / "small")
    change(folder, "fiducial_rays.csv", 11, "012,2", "012,9")
    without("fiducial_rays.csv", *(f"021,{n}" for n in "345678"))(folder)
    append(folder, "points.csv", "106,1,2")
    change(folder, "block.toml", 6, '"m"', '"km"')
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    places = [line.split(": ")[0] for line in caught.value.lines]
    assert places == ["block.toml:6", "points.csv:10", "fiducial_rays.csv:11", "fiducial_rays.csv:18"]
