"""Every way to break a folder, and what the user is told: file, line, object and cure."""

from collections.abc import Callable
from pathlib import Path

import pytest
from cases.folder_edits import STATIONS, Edit, added, dropped, line, removed, table, toml, without_cameras
from cases.small_folder import append, change, make_small_folder, write

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read, read_block_folder

NUMBER = "give a number with a decimal point"
DISTANCES = "from,to,distance,sigma"

CASES: dict[str, tuple[Edit, str]] = {
    # files and tables
    "no block.toml": (
        removed("block.toml"),
        "block.toml: the file is missing; add it to the folder, or drop its entry in block.toml",
    ),
    "no table": (
        removed("images.csv"),
        "images.csv: the file is missing; add it to the folder, or drop its entry in block.toml",
    ),
    "no column": (line("rays.csv", 1, "point,", ""), "rays.csv:1: column 'point' is missing; add it"),
    "unknown column": (
        line("rays.csv", 1, "sx,sy", "sx,sz"),
        "rays.csv:1: column 'sz' is unknown; rename it or drop it; known: image, point, x, y, sx, sy",
    ),
    "column twice": (
        line("control.csv", 1, "sZ,role", "sZ,role,sZ"),
        "control.csv:1: column 'sZ' is given twice; drop one of the two",
    ),
    "truncated row": (
        line("rays.csv", 20, ",,", ""),
        "rays.csv:20: the row '012,107,2693.0699331347178,1730.5418535744063' has 4 fields, the header 6; "
        "complete the row or drop it",
    ),
    "row too long": (
        added("points.csv", "112,1,2,3,4"),
        "points.csv:10: the row '112,1,2,3,4' has 5 fields, the header 4; complete the row or drop it",
    ),
    "empty table": (
        lambda folder: write(folder, "points.csv", "point,X,Y,Z", []),
        "points.csv: the table has no rows; add rows, or drop it and its entry in [tables]",
    ),
    "not UTF-8": (
        lambda folder: (folder / "points.csv").write_bytes(b"point,X,Y,Z\n106,1,2,3\nT\xfcr,1,2,3\n"),
        "points.csv:3: byte 0xfc is not UTF-8; save the file in UTF-8",
    ),
    "quotes": (
        added("points.csv", '"112,1,2,3'),
        "points.csv:10: the row cannot be read: unexpected end of data; close its quotes",
    ),
    # names
    "unknown image": (
        line("rays.csv", 17, "012", "099"),
        "rays.csv:17: point 104 on image 099: image 099 is not in images.csv; "
        "add it there, correct the name or drop the row",
    ),
    "unknown camera": (
        line("images.csv", 3, "wide", "narrow"),
        "images.csv:3: image 012: camera narrow is not in block.toml; known: wide; "
        "add it there, correct the name or drop the row",
    ),
    "ray without point": (
        line("rays.csv", 17, "104", " "),
        "rays.csv:17: point  on image 012: the point has no name; add the name or drop the row",
    ),
    "ray without image": (
        line("rays.csv", 17, "012", ""),
        "rays.csv:17: point 104 on image : the image has no name; add the name or drop the row",
    ),
    "image without name": (
        added("images.csv", ",wide,0,0,100,0,0,0"),
        "images.csv:6: image : the image has no name; add the name or drop the row",
    ),
    "image twice": (
        added("images.csv", "012,wide,0,0,100,0,0,0"),
        "images.csv:6: image 012: is already in line 3; drop one of the two",
    ),
    "point twice": (
        added("points.csv", "103,8,-16,3"),
        "points.csv:10: point 103: is already in line 4; drop one of the two",
    ),
    "control point twice": (
        added("control.csv", "103,,,3,,,0.1,control"),
        "control.csv:7: point 103: is already in line 4; drop one of the two",
    ),
    "ray twice": (
        lambda folder: append(folder, "rays.csv", (folder / "rays.csv").read_text().splitlines()[16]),
        "rays.csv:50: point 104 on image 012: is already in line 17; drop one of the two",
    ),
    "unknown role": (
        line("control.csv", 3, "control", "contrl"),
        "control.csv:3: point 102: role 'contrl' is unknown; known: control, check",
    ),
    "station of unknown image": (
        table("stations", STATIONS, "013,1,2,3,1,1,1"),
        "stations.csv:2: image 013: image 013 is not in images.csv; add it there, correct the name or drop the row",
    ),
    "distance to unknown point": (
        table("distances", DISTANCES, "101,900,10,0.1"),
        "distances.csv:2: distance 101 - 900: to 900 is on no image and has no coordinates; "
        "measure it on an image, give it X, Y and Z in points.csv or control.csv, correct the name or drop the row",
    ),
    "distance to itself": (
        table("distances", DISTANCES, "101,101,10,0.1"),
        "distances.csv:2: distance 101 - 101: both ends are the same; correct one of them or drop the row",
    ),
    # numbers
    "no number": (
        line("rays.csv", 14, "1356.25", "1356;25"),
        f"rays.csv:14: point 101 on image 012: x is '1356;2519991438103', not a finite number; {NUMBER}",
    ),
    "NaN": (
        line("points.csv", 7, "106,-7.0", "106,nan"),
        f"points.csv:7: point 106: X is 'nan', not a finite number; {NUMBER}",
    ),
    "infinite": (
        line("images.csv", 2, "100.0", "inf"),
        f"images.csv:2: image 011: Z0 is 'inf', not a finite number; {NUMBER}",
    ),
    "empty number": (
        line("images.csv", 5, "-2.0", ""),
        "images.csv:5: image 022: omega is not given; give approximate values, such as from GNSS, the flight plan or a "
        "map, with errors below some percent of the height",
    ),
    "negative sigma": (
        line("control.csv", 3, "0.04", "-0.04"),
        "control.csv:3: point 102: the standard deviation sZ is negative; give a positive number",
    ),
    "sigma 0 of a ray": (
        line("rays.csv", 14, ",,", ",0,"),
        "rays.csv:14: point 101 on image 012: the standard deviation sx is 0; "
        "give a positive number, or leave it empty for the default",
    ),
    "sigma 0 of a station": (
        table("stations", STATIONS, "012,1,2,3,0,1,1"),
        "stations.csv:2: image 012: the standard deviation sX is 0; "
        "give a positive number; to fix elements of images use [datum] in block.toml",
    ),
    "sigma 0 without coordinate": (
        line("control.csv", 5, ",,,0.04", ",0,,0.04"),
        "control.csv:5: point 104: sX = 0 fixes X, which is not given; give X or leave sX empty",
    ),
    "negative distance": (
        table("distances", DISTANCES, "101,102,-10,0.1"),
        "distances.csv:2: distance 101 - 102: the distance is not positive; give a positive number or drop the row",
    ),
    "no default sigma": (
        lambda folder: [
            change(folder, "block.toml", 22, "[sigma]", ""),
            change(folder, "block.toml", 22, "image = 0.5", ""),
        ],
        "block.toml: [sigma] image is missing, and 48 rays have no sx, sy; "
        "add the standard deviation of an image coordinate",
    ),
    # block.toml
    "no TOML": (
        toml(18, "[3010.0,", "[3010.0"),
        "block.toml:18: not valid TOML: Unclosed array: principal_point = [3010.0 2490.0]; correct the line",
    ),
    "other format": (toml(1, "1", "2"), "block.toml:1: format is 2; give 1"),
    "unknown unit": (toml(7, "deg", "grad"), "block.toml:7: [units] angle is \"grad\"; give 'deg', 'gon' or 'rad'"),
    "missing unit": (toml(7, 'angle = "deg"', ""), "block.toml:5: [units] angle is missing; add it"),
    "unknown rotation": (
        toml(10, "omega-phi-kappa", "phi-omega-kappa"),
        "block.toml:10: [rotation] rotation system 'phi-omega-kappa' is unknown; "
        "known: omega-phi-kappa, alpha-omega-kappa",
    ),
    "unknown key": (
        toml(15, "width", "widht"),
        "block.toml:15: [cameras.wide] widht is unknown; known keys: image_unit, pixel_size, width, height, "
        "principal_distance, principal_point, distortion, coefficients, estimate, priors, corrections, fiducials",
    ),
    "unknown section": (
        added("block.toml", "[adjustment]\nsteps = 3"),
        "block.toml:30: adjustment is unknown; "
        "known keys: format, name, source, units, rotation, cameras, navigation, sigma, identification, datum, tables",
    ),
    "missing principal distance": (
        toml(17, "principal_distance = 50.0", ""),
        "block.toml:12: [cameras.wide] principal_distance is missing; add it",
    ),
    "negative principal distance": (
        toml(17, "50.0", "-50.0"),
        "block.toml:17: [cameras.wide] principal_distance is -50.0; it should be greater than 0",
    ),
    "no principal point": (
        toml(18, "principal_point = [3010.0, 2490.0]", ""),
        "block.toml:18: [cameras.wide] principal_point is missing; "
        "give principal_point = [x0, y0] in the unit of the rays",
    ),
    "pixel size in mm": (
        toml(13, "px", "mm"),
        "block.toml:14: [cameras.wide] rays in mm have no pixel_size; "
        'drop it, or give the rays in px and image_unit = "px"',
    ),
    "unknown distortion": (
        toml(19, "none", "fish-eye"),
        "block.toml:19: [cameras.wide] distortion 'fish-eye' is unknown; "
        "known: none, brown, brown-affine-last, brown-scale-first, brown-forward, aicon, metashape, bal, ebner, gruen, "
        "opencv-rational, fisheye, fisheye-624, fov, division, eucm",
    ),
    "unknown coefficient": (
        toml(19, '"none"', '"brown"\ncoefficients = { K1 = 0.1, K9 = 0.2 }'),
        "block.toml:20: [cameras.wide] coefficient K9 is unknown to distortion 'brown'; "
        "known: K1, K2, K3, P1, P2, b1, b2",
    ),
    "unknown element": (
        toml(20, "[]", '["x0", "K1", "pixel_size"]'),
        "block.toml:20: [cameras.wide] interior element to estimate K1, pixel_size is unknown to distortion 'none'; "
        "known: principal_distance, x0, y0",
    ),
    "fiducials": (
        toml(20, "[]", '[]\nfiducials = "affine"'),
        "block.toml:21: [cameras.wide] fiducials need the table fiducials and the table fiducial_rays; "
        "name it in [tables], or drop fiducials",
    ),
    "no camera": (
        without_cameras,
        'block.toml: [cameras] is missing; add it, such as [cameras.NAME] image_unit = "px"',
    ),
    "unknown held image": (
        added("block.toml", '[datum]\ntype = "fixed"\nhold = { "012" = ["X0"], "013" = ["X0"] }'),
        "block.toml:32: [datum] image 013 is not in images.csv; correct the name",
    ),
    "unknown held element": (
        added("block.toml", '[datum]\ntype = "fixed"\n[datum.hold]\n012 = ["X0"]\n021 = ["alpha"]'),
        "block.toml:34: [datum] element alpha is unknown; known: X0, Y0, Z0, omega, phi, kappa",
    ),
    # the block
    "point seen once": (
        dropped("rays.csv", "011,112", "012,112", "021,112"),
        "rays.csv:46: point 112 is seen on one image only; "
        "give it control coordinates, measure it on a second image or drop it",
    ),
    "image with few rays": (
        dropped("rays.csv", "012,11", "012,103", "012,104", "012,105", "012,106", "012,107", "012,108", "012,109"),
        "images.csv:3: image 012 has 2 rays, too few for its 6 unknown elements; "
        "measure at least 3 points on it, better 6, or drop the image",
    ),
    "parallel rays": (
        lambda folder: [dropped("rays.csv", "021,112", "022,112")(folder), same_place(folder)],
        "rays.csv:13: point 112 has no coordinates and its rays do not intersect; "
        "give it approximate coordinates, measure it on an image from a different position or drop it",
    ),
    "control of the datum": (
        dropped("control.csv", "103", "104"),
        "control.csv: the control leaves 1 of the 7 parameters of the datum undetermined",
    ),
}


def same_place(folder: Path) -> None:
    """Puts images 011 and 012 at the same place in the same attitude, point 112 at the same place on both."""
    rows = (folder / "images.csv").read_text().splitlines()
    rows[2] = rows[1].replace("011", "012")
    write(folder, "images.csv", rows[0], rows[1:])
    rays = (folder / "rays.csv").read_text().splitlines()
    place = next(row for row in rays if row.startswith("011,112"))
    rays = [place.replace("011", "012", 1) if row.startswith("012,112") else row for row in rays]
    write(folder, "rays.csv", rays[0], rays[1:])


@pytest.mark.parametrize("name", CASES)
def test_broken_folder(tmp_path: Path, name: str) -> None:
    edit, expected = CASES[name]
    folder = make_small_folder(tmp_path / "small")
    edit(folder)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    told = [line for line in caught.value.lines if line.startswith(expected)]
    assert told, "\n".join(caught.value.lines)
    assert len(caught.value.lines) == 1, "\n".join(caught.value.lines)


def test_everything_is_told_at_once(tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    dropped("rays.csv", "011,112", "012,112", "021,112")(folder)
    change(folder, "images.csv", 4, "wide", "narrow")
    change(folder, "rays.csv", 5, "011,104", "013,104")
    change(folder, "rays.csv", 6, "105,", "105,a")
    change(folder, "control.csv", 3, "0.02", "-0.02")
    append(folder, "points.csv", "106,1,2")
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    error = caught.value
    assert [line.split(": ")[0] for line in error.lines] == [
        "images.csv:4",
        "rays.csv:5",
        "rays.csv:6",
        "rays.csv:46",
        "points.csv:10",
        "control.csv:3",
    ]
    assert "image 021" in error.lines[0] and "narrow" in error.lines[0]
    assert "point 104 on image 013" in error.lines[1]
    assert "point 105 on image 011: x is 'a" in error.lines[2]
    assert "point 112 is seen on one image only" in error.lines[3]
    assert "'106,1,2' has 3 fields" in error.lines[4]
    assert "point 102: the standard deviation sX is negative" in error.lines[5]
    assert str(error).startswith("6 problems in the block:\n  images.csv:4: ")


def test_block_toml_and_tables_are_told_together(tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    change(folder, "block.toml", 6, '"m"', '"km"')
    change(folder, "block.toml", 19, "none", "fisheye")
    change(folder, "rays.csv", 17, "012", "099")
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert [line.split(": ")[0] for line in caught.value.lines] == ["block.toml:6", "block.toml:19", "rays.csv:17"]


def test_too_few_observations(tmp_path: Path) -> None:
    """Three points on two images: twelve image coordinates, twenty-one unknowns, seven of them the datum's."""
    folder = make_small_folder(tmp_path / "small")
    dropped("rays.csv", "021", "022", *(f"{i},{p}" for i in ("011", "012") for p in range(104, 113)))(folder)
    dropped("images.csv", "021", "022")(folder)
    change(folder, "block.toml", 29, 'control = "control.csv"', "")
    with pytest.raises(BlockError, match="12 observations do not exceed 21 unknowns, 14 with a fixed datum: M > N"):
        read_block_folder(folder)


@pytest.mark.parametrize("reader", [read, read_block_folder])
def test_no_folder(tmp_path: Path, reader: Callable[[Path], object]) -> None:
    with pytest.raises(BlockError, match="block.toml"):
        reader(tmp_path / "nowhere")


def test_no_block(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("Dear colleague,\n")
    with pytest.raises(BlockError, match="letter.txt has an unknown format; give a folder with block.toml, a BAL"):
        read(tmp_path / "letter.txt")
    with pytest.raises(BlockError, match="has no block.toml"):
        read(tmp_path)
