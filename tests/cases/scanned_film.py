"""The small block as scanned film: rays and fiducials in px, each image in its own place in the scanner."""

from pathlib import Path

import numpy as np
from cases.small_folder import IMAGES, POINTS, image_coordinates, make_small_folder, write

PIXEL = 0.01
NAMES = ("1", "2", "3", "4", "5", "6", "7", "8")
CALIBRATED = np.array([[-22, -17], [22, 17], [-22, 17], [22, -17], [-22, 0], [22, 0], [0, 17], [0, -17.0]])
CALIBRATED += np.random.default_rng(5).normal(0, 0.02, CALIBRATED.shape)
TRUE = {
    "conformal": np.array([[9.98e-3, 2e-5, -21.4], [2e-5, -9.98e-3, 16.2], [0, 0, 1]]),
    "affine": np.array([[9.98e-3, 3e-5, -21.4], [-2e-5, -1.003e-2, 16.2], [0, 0, 1]]),
    "projective": np.array([[9.98e-3, 3e-5, -21.4], [-2e-5, -1.003e-2, 16.2], [3e-7, -2e-7, 1]]),
}


def by(matrix, points):
    """Points under a matrix of the plane."""
    x, y, w = matrix @ np.c_[points, np.ones(len(points))].T
    return np.c_[x / w, y / w]


CAMERA = """\
pixel_size = 0.01
width = 4600
height = 3600
principal_distance = 50.0
principal_point = [0.1, -0.2]
distortion = "none"
estimate = ["principal_distance"]
"""


def rays(coordinates: np.ndarray) -> list[str]:
    names = [(image, point) for image in IMAGES for point in POINTS]
    return [f"{i},{p},{x!r},{y!r},," for (i, p), (x, y) in zip(names, coordinates.tolist(), strict=True)]


def image_transformation(k: int) -> np.ndarray:
    """Film lies differently in the scanner each time."""
    turn, shift = np.eye(3), np.array([[0, 0, 0.3 * k], [0, 0, -0.2 * k], [0, 0, 0]])
    turn[:2, :2] = [[np.cos(0.01 * k), -np.sin(0.01 * k)], [np.sin(0.01 * k), np.cos(0.01 * k)]]
    return turn @ TRUE["affine"] + shift


def film_folder(folder: Path, kind: str = "affine", noise: float = 0.3) -> Path:
    """The small block as scanned film, with noise in rays and fiducials (px)."""
    make_small_folder(folder)
    rng = np.random.default_rng(7)
    mm = (image_coordinates() - [3010.0, 2490.0]) * [PIXEL, -PIXEL] + [0.1, -0.2]
    inverse = [np.linalg.inv(image_transformation(k)) for k in range(4)]
    scan = np.concatenate([by(m, part) for m, part in zip(inverse, mm.reshape(4, 12, 2), strict=True)])
    write(folder, "rays.csv", "image,point,x,y,sx,sy", rays(scan + noise * rng.standard_normal(scan.shape)))
    measured = [by(m, CALIBRATED) + noise * rng.standard_normal((8, 2)) for m in inverse]
    rows = [
        f"{image},{name},{u!r},{v!r}"
        for image, part in zip(IMAGES, measured, strict=True)
        for name, (u, v) in zip(NAMES, part.tolist(), strict=True)
    ]
    write(folder, "fiducial_rays.csv", "image,fiducial,x,y", rows)
    calibrated = [f"wide,{n},{x!r},{y!r}" for n, (x, y) in zip(NAMES, CALIBRATED.tolist(), strict=True)]
    write(folder, "fiducials.csv", "camera,fiducial,x,y", calibrated)
    text = (folder / "block.toml").read_text()
    start, end = text.index("pixel_size"), text.index("[sigma]")
    text = text[:start] + CAMERA + f'fiducials = "{kind}"\n\n' + text[end:]
    (folder / "block.toml").write_text(text + 'fiducials = "fiducials.csv"\nfiducial_rays = "fiducial_rays.csv"\n')
    return folder
