"""A block folder with every table there is, and the same block put together in Python: 4 images of a small site.

Angles in gon. Ground points 1-16; on a house a plumb line P0 P1 P2, a roof R1-R5, a ridge L1-L4; two theodolite
stations T1 T2 that are on no image.
"""

from pathlib import Path

import numpy as np
from cases.small_folder import BLOCK_TOML, IMAGES, PIXEL, X0, Y0, C, orientations, rotation, write, write_images

GON = np.pi / 200
SIGMA = 0.5  # px
CATEGORIES = {"target": 0.2, "map": 1.2}
STRIPS = {"011": "strip 1", "012": "strip 1", "021": "strip 2", "022": "strip 2"}
TIMES = {"011": 5000.0, "012": 5004.0, "021": 7000.0, "022": 7006.0}
SHIFTS = {"strip 1": np.array([0.4, -0.3, 0.2]), "strip 2": np.array([-0.2, 0.5, 0.1])}
LEVER = np.array([0.1, 0.05, 0.3])
BORESIGHT = np.array([0.2, -0.1, 0.3])  # gon
NAVIGATION = """
[navigation."strip 1"]
lever_arm = [0.1, 0.05, 0.3]
boresight = [0.2, -0.1, 0.3]
drift = [0.01, 0.0, 0.0]
estimate = ["shift", "boresight"]
priors = { boresight = 0.05 }

[navigation."strip 2"]
lever_arm = [0.1, 0.05, 0.3]
shift = [-0.2, 0.5, 0.1]
drift = [0.01, 0.0, 0.0]
boresight = [0.2, -0.1, 0.3]
estimate = ["drift"]
priors = { drift = 0.02 }

[identification]
target = 0.2
map = 1.2
"""


def truth() -> dict[str, np.ndarray]:
    """Coordinates of all points."""
    points = {str(k + 1): np.array([15 * (k % 4) - 22, 11 * (k // 4) - 16, 3 * np.sin(2.5 * k)]) for k in range(16)}
    points |= {f"P{k}": np.array([4.0, 6.0, 3.0 * k]) for k in range(3)}
    roof = [(-9, -6), (-2, -5), (-8, 3), (-1, 4), (-5, -1)]
    points |= {f"R{k + 1}": np.array([x, y, 9 + 0.3 * x - 0.1 * y]) for k, (x, y) in enumerate(roof)}
    points |= {f"L{k + 1}": np.array([10.0, -8.0, 7.0]) + 3.0 * k * np.array([0.8, 0.6, 0.05]) for k in range(4)}
    return points | {"T1": np.array([-30.0, 30.0, 1.5]), "T2": np.array([32.0, 28.0, 1.6])}


def centre(image: str) -> np.ndarray:
    """True projection centre."""
    return orientations()[IMAGES.index(image), :3]


def matrix(image: str) -> np.ndarray:
    """True rotation."""
    return rotation(*orientations()[IMAGES.index(image), 3:])


def between(start: str, end: str) -> np.ndarray:
    """From one end to the other; "image:" names a projection centre."""
    ends = [centre(name[6:]) if name.startswith("image:") else truth()[name] for name in (start, end)]
    return ends[1] - ends[0]


def value(kind: str, start: str, end: str) -> float:
    """The true value of a geodetic observation, gon."""
    dx, dy, dz = between(start, end)
    return {
        "distances": np.sqrt(dx**2 + dy**2 + dz**2),
        "horizontal_distances": np.hypot(dx, dy),
        "height_differences": dz,
        "azimuths": np.arctan2(dx, dy) / GON,
        "zenith_angles": np.arctan2(np.hypot(dx, dy), dz) / GON,
    }[kind]


PAIRS = {  # ends and standard deviation
    "distances": ([("1", "4"), ("T1", "P1"), ("T1", "T2"), ("T2", "image:021"), ("image:011", "image:012")], 0.01),
    "horizontal_distances": ([("13", "16"), ("T2", "6")], 0.01),
    "height_differences": ([("T1", "13"), ("T2", "16"), ("5", "12")], 0.005),
    "azimuths": ([("T1", "T2"), ("1", "image:022")], 0.01),
    "zenith_angles": ([("T1", "P2"), ("T2", "L1"), ("T1", "image:011")], 0.01),
}
SETS = {"A": ("T1", 50.0), "B": ("T2", 120.0), "C": ("image:012", 300.0)}  # station and orientation, gon
DIRECTIONS = [
    *(("A", end) for end in ("T2", "P1", "13", "5")),
    *(("B", end) for end in ("T1", "16", "L4")),
    *(("C", end) for end in ("T2", "1", "image:022")),
]
SCALE_BARS = [("long", "1", "2"), ("long", "2", "1"), ("short", "P0", "P2"), ("known", "9", "10"), ("free", "5", "6")]
BARS = {"long": 0.02, "short": 0.01, "known": 0.0, "free": np.nan}  # standard deviations


def bar_length(bar: str) -> float:
    """The true distance of the points it lies between."""
    _, start, end = next(row for row in SCALE_BARS if row[0] == bar)
    return float(np.linalg.norm(between(start, end)))


def make_surveyed_folder(folder: Path) -> Path:
    """Writes the folder."""
    folder.mkdir(parents=True)
    errors = np.random.default_rng(4)
    points = truth()
    toml = BLOCK_TOML.replace('"deg"', '"gon"').replace("estimate = []", 'estimate = ["principal_distance"]')
    toml = toml.replace("[sigma]", "priors = { principal_distance = 0.02 }\n" + NAVIGATION + "\n[sigma]")
    kinds = (*PAIRS, "directions", "scale_bars", "bars", "plumb_lines", "planes", "lines", "stations", "attitudes")
    toml += "".join(f'{kind} = "{kind}.csv"\n' for kind in kinds)
    (folder / "block.toml").write_text(toml, encoding="utf-8")
    start = orientations() + errors.normal(0, [0.5] * 3 + [0.1] * 3, (4, 6))
    write_images(folder, start * [1, 1, 1, *[1 / 0.9] * 3])
    seen = [name for name in points if name[0] != "T"]
    rays = []
    for image in IMAGES:
        for name in seen:
            p = (points[name] - centre(image)) @ matrix(image)
            u = np.array([X0 - C / PIXEL * p[0] / p[2], Y0 + C / PIXEL * p[1] / p[2]]) + errors.normal(0, SIGMA, 2)
            rays.append(f"{image},{name},{u[0]},{u[1]},,")
    write(folder, "rays.csv", "image,point,x,y,sx,sy", rays)
    approximate = [
        f"{n},{','.join(f'{v:.2f}' for v in points[n] + errors.normal(0, 0.1, 3))}" for n in ("T2", "T1", "7")
    ]
    write(folder, "points.csv", "point,X,Y,Z", approximate)
    _control(folder, points, errors)
    _geodetic(folder, errors)
    _figures(folder)
    _navigation(folder, errors)
    return folder


def _control(folder: Path, points: dict[str, np.ndarray], errors: np.random.Generator) -> None:
    rows = []
    for name, covariances, category in (
        ("1", "1e-4,-5e-5,", "target"),
        ("4", ",,", "map"),
        ("13", ",,3e-5", ""),
        ("16", ",,", "target"),
    ):
        x, y, z = points[name] + errors.normal(0, 0.02, 3)
        rows.append(f"{name},{x},{y},{z},0.02,0.02,0.03,control,{covariances},{category}")
    rows.append(f"11,,,{points['11'][2]},,,0,control,,,,map")
    rows.append(f"8,{','.join(map(str, points['8']))},,,,check,,,,")
    write(folder, "control.csv", "point,X,Y,Z,sX,sY,sZ,role,cXY,cXZ,cYZ,category", rows)


def _geodetic(folder: Path, errors: np.random.Generator) -> None:
    for kind, (ends, sigma) in PAIRS.items():
        column = {"height_differences": "difference", "azimuths": "azimuth", "zenith_angles": "angle"}
        rows = [f"{a},{b},{value(kind, a, b) + errors.normal(0, sigma)},{sigma}" for a, b in ends]
        write(folder, f"{kind}.csv", f"from,to,{column.get(kind, 'distance')},sigma", rows)
    rows = []
    for name, end in DIRECTIONS:
        station, orientation = SETS[name]
        direction = (value("azimuths", station, end) - orientation + errors.normal(0, 0.01)) % 400
        rows.append(f"{name},{station},{end},{direction},0.01")
    write(folder, "directions.csv", "set,from,to,direction,sigma", rows)


def _figures(folder: Path) -> None:
    write(folder, "scale_bars.csv", "bar,from,to,sigma", [f"{bar},{a},{b},0.01" for bar, a, b in SCALE_BARS])
    sigmas = {bar: "" if np.isnan(sigma) else str(sigma) for bar, sigma in BARS.items()}
    write(folder, "bars.csv", "bar,length,sigma", [f"{bar},{bar_length(bar) + 0.001},{sigmas[bar]}" for bar in BARS])
    write(folder, "plumb_lines.csv", "line,point,sigma", ["corner,P0,", "corner,P1,0.005", "corner,P2,0.005"])
    write(folder, "planes.csv", "plane,point,sigma", [f"roof,R{k},0.01" for k in range(1, 6)])
    write(folder, "lines.csv", "line,point,sigma", [f"ridge,L{k},0.01" for k in range(1, 5)])


def _navigation(folder: Path, errors: np.random.Generator) -> None:
    stations, attitudes = [], []
    for k, image in enumerate(IMAGES):
        time = TIMES[image] - np.mean([TIMES[i] for i in IMAGES if STRIPS[i] == STRIPS[image]])
        x = centre(image) + matrix(image) @ LEVER + SHIFTS[STRIPS[image]] + [0.01 * time, 0, 0]
        x = x + errors.normal(0, 0.03, 3)
        mounted = matrix(image) @ rotation(*(0.9 * BORESIGHT))
        angles = np.array([np.arctan2(-mounted[1, 2], mounted[2, 2]), np.arcsin(mounted[0, 2])])
        angles = np.append(angles, np.arctan2(-mounted[0, 1], mounted[0, 0])) / GON + errors.normal(0, 0.01, 3)
        group = f"{STRIPS[image]},{TIMES[image]}"
        stations.append(f"{image},{','.join(map(str, x))},0.03,0.03,0.03,{group if k != 3 else ','}")
        attitudes.append(f"{image},{','.join(map(str, angles))},0.01,0.01,0.01,{group if k != 3 else ','}")
    x = centre("022") + errors.normal(0, 0.03, 3)
    stations[3] = f"022,{','.join(map(str, x))},0.03,0.03,0.03,,"
    attitudes[3] = attitudes[3].replace("0.01,0.01,0.01", "5,5,5")  # of no group: its boresight is not known
    write(folder, "stations.csv", "image,X,Y,Z,sX,sY,sZ,group,time", stations)
    write(folder, "attitudes.csv", "image,omega,phi,kappa,somega,sphi,skappa,group,time", attitudes)
