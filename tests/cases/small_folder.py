"""A small block folder written by hand: 4 images, 12 points, control of every sort."""

from pathlib import Path

import numpy as np

IMAGES = ("011", "012", "021", "022")
POINTS = tuple(str(101 + k) for k in range(12))
C, PIXEL, X0, Y0 = 50.0, 0.01, 3010.0, 2490.0

BLOCK_TOML = """\
format = 1
name = "small"
source = "computed"

[units]
object = "m"
angle = "deg"

[rotation]
system = "omega-phi-kappa"

[cameras.wide]
image_unit = "px"
pixel_size = 0.01
width = 6000
height = 4000
principal_distance = 50.0
principal_point = [3010.0, 2490.0]
distortion = "none"
estimate = []

[sigma]
image = 0.5

[tables]
images = "images.csv"
rays = "rays.csv"
points = "points.csv"
control = "control.csv"
"""


def rotation(omega: float, phi: float, kappa: float) -> np.ndarray:
    """Rx(omega) Ry(phi) Rz(kappa), angles in degrees."""
    (cw, sw), (cp, sp), (ck, sk) = ((np.cos(a), np.sin(a)) for a in np.radians([omega, phi, kappa]))
    about_x = np.array([[1, 0, 0], [0, cw, -sw], [0, sw, cw]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return about_x @ about_y @ np.array([[ck, -sk, 0], [sk, ck, 0], [0, 0, 1]])


def orientations() -> np.ndarray:
    """X0, Y0, Z0, omega, phi, kappa of the images."""
    centres = [[-20, -15, 100], [20, -14, 102], [-19, 16, 99], [21, 15, 101]]
    angles = [[2, -3, 10], [-1, 4, -5], [3, 2, 175], [-2, -1, 184]]
    return np.array([[*centre, *angle] for centre, angle in zip(centres, angles, strict=True)], float)


def object_points() -> np.ndarray:
    """X, Y, Z of the points."""
    return np.array([[15 * (k % 4) - 22, 16 * (k // 4) - 16, 3 * np.sin(2.5 * k)] for k in range(len(POINTS))])


def image_coordinates() -> np.ndarray:
    """u, v in px of every point on every image, image by image."""
    rows = []
    for orientation in orientations():
        p = (object_points() - orientation[:3]) @ rotation(*orientation[3:])
        rows.append(np.c_[X0 - C / PIXEL * p[:, 0] / p[:, 2], Y0 + C / PIXEL * p[:, 1] / p[:, 2]])
    return np.concatenate(rows)


def make_small_folder(folder: Path) -> Path:
    """Writes the block: approximate coordinates for the first eight points; control 101-104, check point 105."""
    folder.mkdir(parents=True, exist_ok=True)
    rays = [
        f"{image},{point},{x!r},{y!r},,"
        for (image, point), (x, y) in zip(
            ((image, point) for image in IMAGES for point in POINTS), image_coordinates().tolist(), strict=True
        )
    ]
    points = object_points().tolist()
    approximate = [f"{name},{x:.1f},{y:.1f},{z:.1f}" for name, (x, y, z) in zip(POINTS[:8], points, strict=False)]
    (x1, y1, z1), (x2, y2, z2), (x3, y3, _), (_, _, z4), (x5, y5, z5) = points[:5]
    control = [
        f"101,{x1!r},{y1!r},{z1!r},0,0,0,control",
        f"102,{x2!r},{y2!r},{z2!r},0.02,0.02,0.04,control",
        f"103,{x3!r},{y3!r},,0.02,0.02,,control",
        f"104,,,{z4!r},,,0.04,control",
        f"105,{x5!r},{y5!r},{z5!r},,,,check",
    ]
    write_images(folder, orientations())
    write(folder, "rays.csv", "image,point,x,y,sx,sy", rays)
    write(folder, "points.csv", "point,X,Y,Z", approximate)
    write(folder, "control.csv", "point,X,Y,Z,sX,sY,sZ,role", control)
    (folder / "block.toml").write_text(BLOCK_TOML, encoding="utf-8")
    return folder


def write(folder: Path, file: str, header: str, rows: list[str]) -> None:
    """Writes a table."""
    (folder / file).write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


def write_images(folder: Path, rows: np.ndarray, angles: str = "omega,phi,kappa") -> None:
    """Writes images.csv from X0, Y0, Z0 and three angles an image."""
    images = [f"{name},wide,{','.join(map(repr, row))}" for name, row in zip(IMAGES, rows.tolist(), strict=True)]
    write(folder, "images.csv", f"image,camera,X0,Y0,Z0,{angles}", images)


def change(folder: Path, file: str, line: int, old: str, new: str) -> None:
    """Replaces a part of one line; a line that becomes empty is taken out."""
    path = folder / file
    lines = path.read_text(encoding="utf-8").splitlines()
    assert old in lines[line - 1], lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path.write_text("\n".join(row for k, row in enumerate(lines) if row or k != line - 1) + "\n", encoding="utf-8")


def append(folder: Path, file: str, text: str) -> None:
    """Adds a line at the end."""
    with (folder / file).open("a", encoding="utf-8") as end:
        end.write(text + "\n")
