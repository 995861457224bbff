"""The photographs of Sceaux castle: their block as COLMAP publishes it, and the names of its images."""

from pathlib import Path

import numpy as np

import jaxbundle as jb


def sceaux_rays(folder: Path) -> dict[str, list]:
    """image, point, x, y of all rays of points, the first one of rays that are repeated."""
    lines = [s for s in (folder / "txt" / "images.txt").read_text().splitlines() if not s.startswith("#")]
    rays: dict[str, list] = {"image": [], "point": [], "x": [], "y": []}
    for head, row in zip(lines[::2], lines[1::2], strict=True):
        values = np.array(row.split(), float).reshape(-1, 3)
        values = values[values[:, 2] >= 0]
        values = values[np.unique(values[:, 2], return_index=True)[1]]
        rays["image"] += [head.split()[9]] * len(values)
        rays["point"] += [str(int(p)) for p in values[:, 2]]
        rays["x"] += values[:, 0].tolist()
        rays["y"] += values[:, 1].tolist()
    return rays


def sceaux_block(folder: Path, rays: dict[str, list]) -> jb.Block:
    """The block of the rays, its interior unknown: f, x0, y0, K1, K2."""
    lines = [s for s in (folder / "txt" / "images.txt").read_text().splitlines() if not s.startswith("#")]
    images: dict[str, list] = {k: [] for k in ("image", "camera", "X0", "Y0", "Z0", "omega", "phi", "kappa")}
    for head in lines[::2]:
        q0, q1, q2, q3, *t = (float(x) for x in head.split()[1:8])
        r = np.array(  # camera from object, z forward, y down
            [
                [1 - 2 * (q2 * q2 + q3 * q3), 2 * (q1 * q2 - q0 * q3), 2 * (q1 * q3 + q0 * q2)],
                [2 * (q1 * q2 + q0 * q3), 1 - 2 * (q1 * q1 + q3 * q3), 2 * (q2 * q3 - q0 * q1)],
                [2 * (q1 * q3 - q0 * q2), 2 * (q2 * q3 + q0 * q1), 1 - 2 * (q1 * q1 + q2 * q2)],
            ]
        )
        centre, m = -r.T @ t, r.T @ np.diag([1.0, -1.0, -1.0])
        angles = np.arctan2(-m[1, 2], m[2, 2]), np.arcsin(m[0, 2]), np.arctan2(-m[0, 1], m[0, 0])
        row = [head.split()[9], "c", *centre, *np.degrees(angles)]
        for column, value in zip(images, row, strict=True):
            images[column].append(value)
    points: dict[str, list] = {"point": [], "X": [], "Y": [], "Z": []}
    used = set(rays["point"])
    for row in (folder / "txt" / "points3D.txt").read_text().splitlines():
        if not row.startswith("#") and row.split()[0] in used:
            for column, value in zip(points, row.split(), strict=False):
                points[column].append(value if column == "point" else float(value))
    camera = {
        "image_unit": "px",
        "width": 2832,
        "height": 2128,
        "principal_distance": 2971.71,
        "principal_point": [1416.0, 1064.0],
        "distortion": "metashape",
        "coefficients": {"K1": -0.164224},
        "estimate": ["principal_distance", "x0", "y0", "K1", "K2"],
    }
    return jb.Block.from_tables(
        cameras={"c": camera},
        images=images,
        rays=rays,
        points=points,
        sigma=1.0,
        datum={"type": "minimal"},
        check_start=False,
    )
