"""flight.toml: what it says becomes a flight, and all that is wrong is told at once, with line and cure."""

import math

import numpy as np
import pytest

from jaxbundle.block.problems import BlockError
from jaxbundle.io import read_flight
from jaxbundle.io.flight_settings import CAMERAS
from jaxbundle.planning.accuracy import Specification
from jaxbundle.planning.flight import ControlSet, Navigation, plan_problems

WHOLE = """
name = "Quarry"
seed = 4
noise = 0.5
[camera]
name = "zenmuse-p1-35"
coefficients = { K1 = 1e-5 }
estimate = ["principal_distance"]
errors = { x0 = 0.5 }
[flight]
gsd = 0.02
forward_overlap = 80
side_overlap = 0.6
area = [[0, 0], [600, 0], [650, 400], [0, 420]]
headings = [70, 160]
tilt = 2
[terrain]
type = "waves"
relief = 30
wavelength = 300
[ties]
layout = "random"
points_per_image = 30
[sigma]
image = 0.5
[[control]]
layout = "corners"
sigma = 0.01
[[control]]
layout = "points"
kind = "height"
sigma = [0.02, 0.02, 0.0]
points = [[10, 20], [30, 40]]
[check]
points = [[100, 100]]
[gnss]
sigma = [0.02, 0.02, 0.03]
systematic = "strip"
shift = 0.2
lever_arm = [0.1, 0, 0.3]
[ins]
sigma = 0.01
boresight = [1, 0, 0]
estimate_offset = true
[gross_errors]
share = 0.01
[specification]
xy = 0.02
z = 0.03
"""


@pytest.fixture
def written(tmp_path):
    """Writes flight.toml; its path."""

    def write(text):
        path = tmp_path / "flight.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_everything_a_file_can_say(written):
    plan, specification = read_flight(written(WHOLE))
    assert specification == Specification(0.02, 0.03, 0.95)
    assert plan.height == pytest.approx(0.02 * 35.0 / 0.0044)
    assert (plan.forward_overlap, plan.side_overlap) == (0.8, 0.6)
    assert plan.headings == pytest.approx([math.radians(70), math.radians(160)])
    assert plan.camera.estimate == ("principal_distance",) and plan.camera.model.name == "brown"
    assert plan.camera.interior()["x0"] - plan.camera.given()["x0"] == 0.5
    assert plan.terrain.at(np.array([75.0]), np.array([75.0])) == pytest.approx([15.0])
    assert plan.control == (
        ControlSet("corners", sigmas=(0.01, 0.01, 0.01)),
        ControlSet("points", "height", (0.02, 0.02, 0.0), points=((10.0, 20.0), (30.0, 40.0))),
    )
    assert plan.gnss == Navigation((0.02, 0.02, 0.03), "strip", 0.2, offset=(0.1, 0.0, 0.3))
    degree = math.radians(1)
    assert plan.ins == Navigation((0.01 * degree,) * 3, offset=(degree, 0.0, 0.0), offset_unknown=True)
    assert plan.check_points == ((100.0, 100.0),) and plan.gross_errors.share == 0.01
    assert (plan.seed, plan.noise, plan.name, plan.sigma) == (4, 0.5, "Quarry", 0.5)
    assert plan_problems(plan) == []


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_can_be_flown(name, written):
    text = f'[camera]\nname = "{name}"\n[flight]\nscale = 10000\nstrips = 1\nimages = 3\n'
    plan = read_flight(written(text)).plan
    assert plan.height == pytest.approx(10 * CAMERAS[name].principal_distance)
    assert plan_problems(plan) == []


def test_all_problems_at_once(written):
    path = written("""colour = 3
[camera]
name = "film"
[flight]
height = 100
forward_overlap = 40
strips = 2
[[control]]
layout = "corners"
sigma = 0.02
[[control]]
layout = "perimetre"
sigma = [0.1, 0.2]
[gnss]
sigma = 0
[specification]
xy = 0.1
""")
    with pytest.raises(BlockError) as told:
        read_flight(path)
    assert told.value.lines == (
        "flight.toml:1: colour is unknown; known keys: name, seed, noise, camera, flight, terrain, ties, sigma,"
        " control, check, gnss, ins, gross_errors, specification",
        f"flight.toml:3: [camera] camera 'film' is unknown; did you mean film-305? known: {', '.join(CAMERAS)}",
        "flight.toml:6: [flight] forward_overlap is 0.4; give 0.5 or more: each point must lie on two images",
        "flight.toml:12: [control] layout of control 'perimetre' is unknown; did you mean perimeter? known: rows,"
        " corners, perimeter, grid, chains, points",
        "flight.toml:13: [control] sigma has 2 elements; give 3, in brackets",
        "flight.toml:15: [gnss] sigma is 0.0; it should be greater than 0",
        "flight.toml:16: [specification] z is missing; add it, such as z = 0.03, in metres",
    )


MINIMAL = '[camera]\nname = "film-153"\n[flight]\n{flight}\n{rest}'
STRIP = "height = 1500\nstrips = 1\nimages = 3"


@pytest.mark.parametrize(
    ("flight", "rest", "message"),
    [
        ("strips = 1\nimages = 3", "", r"\[flight\] has no height; give one of height, scale or gsd"),
        ("height = 9\nscale = 9\nstrips = 1\nimages = 3", "", "has height and scale; give one of"),
        ("height = 9", "", "has an area and strips, or neither; give either area, or strips and images"),
        ("height = 9\nstrips = 2", "", "has only one of strips and images; give both"),
        (STRIP, '[terrain]\ntype = "waves"', "of type waves has no relief, wavelength; give relief and wavelength"),
        (STRIP, '[terrain]\ntype = "grid"\nfile = "dem.csv"', "file dem.csv cannot be used"),
        (
            STRIP,
            '[[control]]\nlayout = "points"\nsigma = 0',
            "layout = 'points' and the key points need each other; give both or neither",
        ),
        (STRIP, '[gnss]\nsigma = 1\nsystematic = "day"', "'day' is unknown; known: none, block, strip"),
    ],
)
def test_what_does_not_fit_together(flight, rest, message, written):
    with pytest.raises(BlockError, match=message):
        read_flight(written(MINIMAL.format(flight=flight, rest=rest)))


def test_camera_without_data(written):
    with pytest.raises(BlockError, match="has no principal_distance, height; give them in mm, or the name of a camera"):
        read_flight(written("[camera]\nwidth = 10\n[flight]\nheight = 9\nstrips = 1\nimages = 3"))
    with pytest.raises(BlockError, match="there is no such file"):
        read_flight(written("").parent / "other.toml")


def test_terrain_of_a_grid(written, tmp_path):
    (tmp_path / "dem.csv").write_text("X,Y,Z\n0,0,10\n0,100,20\n100,0,30\n100,100,40\n")
    text = MINIMAL.format(flight=STRIP, rest='[terrain]\ntype = "grid"\nfile = "dem.csv"')
    terrain = read_flight(written(text)).plan.terrain
    assert terrain.at(np.array([50.0, -10.0]), np.array([50.0, 200.0])) == pytest.approx([25.0, 20.0])
