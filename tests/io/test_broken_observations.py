"""Every way to break the tables of observations and their sections, and what the user is told."""

from pathlib import Path

import pytest
from cases.folder_edits import STATIONS, Edit, added, dropped, line, table, toml
from cases.small_folder import append, change, make_small_folder, write

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read_block_folder

ROW = "give a number or drop the row"
ON_NO_IMAGE = (
    "measure it on an image, give it X, Y and Z in points.csv or control.csv, correct the name or drop the row"
)
DIRECTIONS, AZIMUTHS, ZENITHS = "set,from,to,direction,sigma", "from,to,azimuth,sigma", "from,to,angle,sigma"
SCALE_BARS, BARS = "bar,from,to,sigma", "bar,length,sigma"
ATTITUDES = "image,omega,phi,kappa,somega,sphi,skappa,group,time"
GROUPED = "image,X,Y,Z,sX,sY,sZ,group,time"
CONTROL = "point,X,Y,Z,sX,sY,sZ,role,cXY,cXZ,cYZ,category"


def both(*edits: Edit) -> Edit:
    """Several edits."""
    return lambda folder: [edit(folder) for edit in edits]


def navigation(*keys: str) -> Edit:
    """Adds the section of a group."""
    return added("block.toml", "\n".join(["[navigation.strip]", *keys]))


def control(*rows: str) -> Edit:
    """Further rows of control.csv, which get the columns of covariances and category."""

    def edit(folder: Path) -> None:
        lines = (folder / "control.csv").read_text().splitlines()[1:]
        write(folder, "control.csv", CONTROL, [*(f"{row},,,," for row in lines), *rows])

    return edit


def station(group: str, *times: str) -> Edit:
    """Stations of a group."""
    rows = [f"{image},1,2,3,1,1,1,{group},{time}" for image, time in zip(("011", "012", "021"), times, strict=False)]
    return table("stations", GROUPED, *rows)


def free_network(*keys: str) -> Edit:
    """Inner constraints in place of control."""

    def edit(folder: Path) -> None:
        change(folder, "block.toml", 29, 'control = "control.csv"', "")
        (folder / "control.csv").unlink()
        append(folder, "block.toml", "\n".join(["[datum]", 'type = "inner"', *keys]))

    return edit


CASES: dict[str, tuple[Edit, str]] = {
    # ends
    "unknown image as an end": (
        table("azimuths", AZIMUTHS, "101,image:013,10,0.1"),
        "azimuths.csv:2: azimuth 101 - image:013: to image:013 is not in images.csv; "
        "add it there, correct the name behind 'image:' or drop the row",
    ),
    "station without coordinates": (
        table("azimuths", AZIMUTHS, "T1,101,10,0.1"),
        f"azimuths.csv:2: azimuth T1 - 101: from T1 is on no image and has no coordinates; {ON_NO_IMAGE}",
    ),
    "station with two coordinates": (
        both(table("azimuths", AZIMUTHS, "T1,101,10,0.1"), added("points.csv", "T1,1,2,")),
        f"azimuths.csv:2: azimuth T1 - 101: from T1 is on no image and has no coordinates; {ON_NO_IMAGE}",
    ),
    "station with too few observations": (
        both(table("azimuths", AZIMUTHS, "T1,101,10,0.1"), added("points.csv", "T1,1,2,3")),
        "points.csv:10: point T1 is seen on no image; give it control coordinates, measure it on a second image or "
        "drop it",
    ),
    "the same image twice": (
        table("height_differences", "from,to,difference,sigma", "image:011,image:011,0,1"),
        "height_differences.csv:2: height difference image:011 - image:011: both ends are the same; "
        "correct one of them or drop the row",
    ),
    "no end": (
        table("azimuths", AZIMUTHS, "101,,10,0.1"),
        "azimuths.csv:2: azimuth 101 - : the to has no name; add the name or drop the row",
    ),
    # values
    "horizontal distance of 0": (
        table("horizontal_distances", "from,to,distance,sigma", "101,102,0,1"),
        "horizontal_distances.csv:2: horizontal distance 101 - 102: the horizontal distance is not positive; "
        "give a positive number or drop the row",
    ),
    "zenith angle of the second face": (
        table("zenith_angles", ZENITHS, "101,102,271.2,0.1"),
        "zenith_angles.csv:2: zenith angle 101 - 102: the zenith angle is not between 0 and 180; "
        "reduce it to the first face, or drop the row",
    ),
    "no value": (
        table("azimuths", AZIMUTHS, "101,102,,0.1"),
        f"azimuths.csv:2: azimuth 101 - 102: azimuth is not given; {ROW}",
    ),
    "sigma 0": (
        table("directions", DIRECTIONS, "A,101,102,10,0"),
        "directions.csv:2: direction 101 - 102 of set A: the standard deviation sigma is 0; give a positive number",
    ),
    # sets and bars
    "set with two stations": (
        table("directions", DIRECTIONS, "A,101,103,10,0.1", "A,102,103,10,0.1"),
        "directions.csv:3: direction 102 - 103 of set A: set A was observed from 101 (line 2); give it its own set",
    ),
    "set without name": (
        table("directions", DIRECTIONS, ",101,103,10,0.1"),
        "directions.csv:2: direction 101 - 103 of set : the set has no name; add the name or drop the row",
    ),
    "no bars": (
        table("scale_bars", SCALE_BARS, "b,101,102,0.1"),
        "block.toml:30: [tables] scale_bars need the table bars; "
        'add a table bar,length,sigma and name it: bars = "bars.csv"',
    ),
    "unknown bar": (
        both(table("scale_bars", SCALE_BARS, "b,101,102,0.1"), table("bars", BARS, "c,1,0")),
        "scale_bars.csv:2: scale bar 101 - 102 of bar b: bar b is not in bars.csv; known: c; "
        "add it there, correct the name or drop the row",
    ),
    "bar twice": (
        both(table("scale_bars", SCALE_BARS, "b,101,102,0.1"), table("bars", BARS, "b,1,0", "b,2,0")),
        "bars.csv:3: bar b: is already in line 2; drop one of the two",
    ),
    "length of 0": (
        both(table("scale_bars", SCALE_BARS, "b,101,102,0.1"), table("bars", BARS, "b,0,")),
        "bars.csv:2: bar b: the length is not positive; give a positive number, approximate where sigma is empty",
    ),
    # figures
    "plane of two points": (
        table("planes", "plane,point,sigma", "roof,101,0.1", "roof,102,0.1"),
        "planes.csv:2: plane roof has 2 of at least 3 points; name more of its points or drop it",
    ),
    "plumb line of one point": (
        table("plumb_lines", "line,point,sigma", "p,101,0.1"),
        "plumb_lines.csv:2: plumb line p has 1 of at least 2 points; name more of its points or drop it",
    ),
    "unknown point of a line": (
        table("lines", "line,point,sigma", "l,101,0.1", "l,102,0.1", "l,900,0.1"),
        f"lines.csv:4: point 900 of line l: point 900 is on no image and has no coordinates; {ON_NO_IMAGE}",
    ),
    "point of a line twice": (
        table("lines", "line,point,sigma", "l,101,0.1", "l,102,0.1", "l,101,0.1"),
        "lines.csv:4: point 101 of line l: is already in line 2; drop one of the two",
    ),
    "no sigma of a plane": (
        table("planes", "plane,point,sigma", "roof,101,0.1", "roof,102,", "roof,105,0.1"),
        f"planes.csv:3: point 102 of plane roof: sigma is not given; {ROW}",
    ),
    "no sigma of a plumb line": (
        table("plumb_lines", "line,point,sigma", "p,101,", "p,102,"),
        f"plumb_lines.csv:3: point 102 of plumb line p: sigma is not given; {ROW}",
    ),
    "points of a plane on one line": (
        both(
            table("planes", "plane,point,sigma", "roof,106,0.1", "roof,107,0.1", "roof,108,0.1"),
            line("points.csv", 7, "106,-7.0,0.0,-0.2", "106,0,0,0"),
            line("points.csv", 8, "107,8.0,0.0,2.0", "107,1,2,3"),
            line("points.csv", 9, "108,23.0,0.0,-2.9", "108,2,4,6"),
        ),
        "planes.csv:2: plane roof: its points lie on one line; "
        "name points that are spread over the plane, or correct their coordinates",
    ),
    # control
    "covariance without weight": (
        control("106,1,2,,0.1,0.1,,control,,0.001,,"),
        "control.csv:7: point 106: cXZ is given, but not both sigmas of observed X and Z; give both, ",
    ),
    "covariance too large": (
        control("106,1,2,3,0.1,0.1,0.1,control,0.02,,,"),
        "control.csv:7: point 106: the covariance matrix of its coordinates is not positive definite; "
        "each covariance must be smaller than the product of its two sigmas; correct them",
    ),
    "unknown category": (
        both(control("106,1,2,3,0.1,0.1,0.1,control,,,,map"), added("block.toml", "[identification]\ntarget = 0.1")),
        "control.csv:7: point 106: category 'map' is not in [identification] of block.toml; "
        "add its standard deviation there, correct the name or leave it empty",
    ),
    "negative identification": (
        added("block.toml", "[identification]\ntarget = -0.1"),
        "block.toml:31: [identification] target is -0.1; it should be greater than 0",
    ),
    # navigation
    "unknown group": (
        station("strip"),
        "stations.csv: the table has no rows; add rows, or drop it and its entry in [tables]",
    ),
    "group that is no section": (
        station("strip", "0"),
        "stations.csv:2: image 011: group strip is not in block.toml; "
        "add [navigation.strip] there, correct the name or leave it empty",
    ),
    "drift without times": (
        both(station("strip", "1", "", "2"), navigation('estimate = ["drift"]')),
        "stations.csv:3: image 012: group strip has a drift and the row has no time; give the time in a column time",
    ),
    "drift at one time": (
        both(station("strip", "7", "7"), navigation('estimate = ["drift"]')),
        "stations.csv:2: image 011: group strip has a drift to estimate and all its times are equal; "
        "give its true times, a prior of the drift, or do not estimate it",
    ),
    "attitude of an unknown image": (
        table("attitudes", ATTITUDES, "013,1,2,3,1,1,1,,"),
        "attitudes.csv:2: image 013: image 013 is not in images.csv; add it there, correct the name or drop the row",
    ),
    "sigma 0 of an attitude": (
        table("attitudes", ATTITUDES, "012,1,2,3,0,1,1,,"),
        "attitudes.csv:2: image 012: the standard deviation somega is 0; "
        "give a positive number; to fix elements of images use [datum] in block.toml",
    ),
    "unknown systematic error": (
        navigation('estimate = ["shift", "tilt"]'),
        "block.toml:31: [navigation.strip] unknown parameters to estimate: tilt; "
        "known: lever_arm, shift, drift, boresight, attitude_shift, attitude_drift",
    ),
    "prior of what is held": (
        navigation('estimate = ["shift"]', "priors = { drift = 0.1 }"),
        "block.toml:32: [navigation.strip] drift has a prior and is not estimated; "
        "name it in estimate, or drop its prior",
    ),
    "two numbers of a shift": (
        navigation("shift = [1.0, 2.0]"),
        "block.toml:31: [navigation.strip] shift is [1.0, 2.0]; List should have at least 3 items",
    ),
    "unknown key of a group": (
        navigation("lever = [1.0, 2.0, 3.0]"),
        "block.toml:31: [navigation.strip] lever is unknown; known keys: lever_arm, shift, drift, boresight, "
        "attitude_shift, attitude_drift, estimate, priors",
    ),
    "group without name": (
        added("block.toml", "[navigation]\nshift = [1.0, 2.0, 3.0]"),
        "block.toml:31: [navigation.shift] shift is not a section; write it as [navigation.shift] and its keys below",
    ),
    # interior
    "prior of a held element": (
        toml(20, "[]", '["x0"]\npriors = { y0 = 0.1 }'),
        "block.toml:21: [cameras.wide] y0 has a prior and is not estimated; name it in estimate, or drop its prior",
    ),
    "negative prior": (
        toml(20, "[]", '["x0"]\npriors = { x0 = -0.1 }'),
        "block.toml:21: [cameras.wide] x0 is -0.1; it should be greater than 0",
    ),
    # datum
    "unknown datum": (
        added("block.toml", '[datum]\ntype = "free"'),
        "block.toml:31: [datum] datum 'free' is unknown; known: fixed, minimal, inner",
    ),
    "free network that holds": (
        free_network('hold = { "011" = ["X0"] }'),
        'block.toml:31: [datum] a free network fixes no elements; drop hold, or give type = "fixed"',
    ),
    "points of another datum": (
        added("block.toml", '[datum]\ntype = "minimal"\npoints = ["101", "102", "103"]'),
        "block.toml:32: [datum] datum 'minimal' has no points; drop it, or give type = \"inner\"",
    ),
    "two points of a free network": (
        free_network('points = ["101", "102"]'),
        "block.toml:31: [datum] 2 points are too few for inner constraints; name 3 or more, or none",
    ),
    "unknown point of a free network": (
        free_network('points = ["101", "102", "103", "900"]'),
        "block.toml:31: [datum] point 900 is not in rays.csv; correct its name or drop it",
    ),
    "unknown element of a free network": (
        free_network('elements = ["translation", "scale"]'),
        "block.toml:31: [datum] elements are translation, scale; "
        'give elements = ["translation", "rotation"], and "scale" where no observation determines it',
    ),
    "scale that nothing gives": (
        free_network('elements = ["translation", "rotation"]'),
        "block.toml:31: [datum] elements exclude the scale, and no observed distance or scale bar determines it; "
        'add "scale" to elements, or observe a distance',
    ),
    "scale that is given": (
        both(
            table("distances", "from,to,distance,sigma", "101,112,60,0.01"),
            free_network('elements = ["translation", "rotation", "scale"]'),
        ),
        "block.toml:32: [datum] elements include the scale, but observed distances or scale bars determine it; "
        'drop "scale" from elements, or drop the observations that determine it',
    ),
    "free network with control": (
        added("block.toml", '[datum]\ntype = "inner"'),
        "control.csv: the inner constraints of a free network and control, observed stations or fixed elements exclude "
        'each other; make the control points check points, or drop type = "inner" of [datum]',
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_broken_observations(tmp_path: Path, name: str) -> None:
    edit, expected = CASES[name]
    folder = make_small_folder(tmp_path / "small")
    edit(folder)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    assert len(caught.value.lines) == 1, "\n".join(caught.value.lines)
    assert caught.value.lines[0].startswith(expected), caught.value.lines[0]


def test_told_with_all_the_rest(tmp_path: Path) -> None:
    """Wrong rows of many tables at once; a point that only wrong rows name is told once."""
    folder = make_small_folder(tmp_path / "small")
    for edit in (
        table("azimuths", AZIMUTHS, "101,T1,1,0.1"),
        table("planes", "plane,point,sigma", "roof,101,-1", "roof,102,1", "roof,T1,1"),
        table("stations", STATIONS, "011,a,1,1,1,1,1"),
        dropped("rays.csv", "011,112", "012,112", "021,112"),
    ):
        edit(folder)
    with pytest.raises(BlockError) as caught:
        read_block_folder(folder)
    places = [told.split(": ")[0] for told in caught.value.lines]
    assert places == ["rays.csv:46", "stations.csv:2", "azimuths.csv:2", "planes.csv:2", "planes.csv:4"]


def test_what_is_defined_and_not_used_is_noted(tmp_path: Path) -> None:
    folder = make_small_folder(tmp_path / "small")
    table("scale_bars", SCALE_BARS, "b,101,102,0.1")(folder)
    table("bars", BARS, "b,15,0", "c,1,0", "d,1,")(folder)
    navigation('estimate = ["shift"]')(folder)
    block = read_block_folder(folder)
    assert tuple(note.words for note in block.structure.findings) == (
        "bars c, d are in no table and are not used",
        "navigation group strip is in no table and is not used",
    )
    assert [parameter.name for parameter in block.structure.parameters] == ["length of bar b"]
