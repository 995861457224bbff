"""From 18 photographs of a small aircraft to an adjusted block: python tests/benchmarks/brighton.py [--block FOLDER]

Measures ../shared/data/images/brighton (or takes a block folder measured before), starts every image as a vertical
photograph at its station, adjusts with self-calibration and prints time, memory, rays and sigma0.

The start: kappa and height of all images together from the stations and the tie points, linear in a_i, b_i, X_p, Y_p:

    X_p = X0_i + a_i x - b_i y,    Y_p = Y0_i + b_i x + a_i y        kappa = atan2(b, a), height = c sqrt(a^2 + b^2)
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl
from scipy.sparse import coo_array
from scipy.sparse.linalg import lsqr

from jaxbundle.cli import runtime

DATA = Path(__file__).parents[3] / "shared" / "data" / "images" / "brighton"
SENSOR_WIDTH, FOCAL, COLUMNS, ROWS = 6.17, 3.61, 2000, 1125  # mm, mm, px
ROBUST = 4  # rounds that leave out rays beyond three times the median


def vertical_start(folder: Path) -> dict[str, pl.DataFrame]:
    """The tables of a measured block with orientations of vertical photographs."""
    tables = {kind: pl.read_csv(folder / f"{kind}.csv") for kind in ("images", "rays", "stations")}
    c = FOCAL / SENSOR_WIDTH * COLUMNS
    names, points = tables["images"]["image"].to_list(), tables["rays"]["point"].to_numpy() - 1
    image = np.array([names.index(name) for name in tables["rays"]["image"]])
    x, y = tables["rays"]["x"].to_numpy() - COLUMNS / 2, ROWS / 2 - tables["rays"]["y"].to_numpy()
    order = [tables["stations"]["image"].to_list().index(name) for name in names]
    station = tables["stations"].select("X", "Y", "Z").to_numpy()[order]
    n, m = len(names), int(points.max()) + 1
    good, off, found = np.ones(len(image), bool), np.zeros(len(image)), np.zeros(2 * n + 2 * m)
    for _ in range(ROBUST):
        k, i, p = np.arange(good.sum()), image[good], points[good]
        one = np.ones(len(k))
        rows = np.concatenate([k, k, k, k + len(k), k + len(k), k + len(k)])
        columns = np.concatenate([i, n + i, 2 * n + p, n + i, i, 2 * n + m + p])
        values = np.concatenate([x[good], -y[good], -one, x[good], y[good], -one])
        a = coo_array((values, (rows, columns)), (2 * len(k), 2 * n + 2 * m)).tocsr()
        found = lsqr(a, -np.concatenate([station[i, 0], station[i, 1]]), atol=1e-10, btol=1e-10, iter_lim=4000)[0]
        u, v = found[:n], found[n : 2 * n]
        dx = station[image, 0] + u[image] * x - v[image] * y - found[2 * n + points]
        dy = station[image, 1] + v[image] * x + u[image] * y - found[2 * n + m + points]
        off = np.hypot(dx, dy)
        good = off < 3 * np.median(off)
    u, v, ground = found[:n], found[n : 2 * n], found[2 * n :].reshape(2, m)
    kappa, height = np.degrees(np.arctan2(v, u)), c * np.hypot(u, v)
    print(
        "kappa", np.round(kappa, 1), "height", np.round(height, 1), "median off", round(float(np.median(off)), 2), "m"
    )
    oriented = tables["images"].with_columns(
        *(pl.Series(name, station[:, j]) for j, name in enumerate(("X0", "Y0", "Z0"))),
        pl.Series("omega", np.zeros(n)),
        pl.Series("phi", np.zeros(n)),
        pl.Series("kappa", kappa),
    )
    shown = np.bincount(points, good, m)  # points that the vertical start places
    z = station[:, 2].mean() - np.median(height)
    start = {"point": [str(p + 1) for p in range(m)], "X": ground[0], "Y": ground[1], "Z": np.full(m, z)}
    tables["images"] = oriented
    tables["points"] = pl.DataFrame(start).filter(pl.Series(shown >= 0))
    return tables


def main() -> None:
    """Measures, adjusts, prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--block", type=Path)
    given = parser.parse_args()
    runtime.start()
    import jaxbundle as jb

    folder = given.block
    if folder is None:
        began = time.perf_counter()
        folder = Path(tempfile.mkdtemp()) / "brighton"
        camera = jb.measuring.CameraGiven(principal_distance=FOCAL / SENSOR_WIDTH * COLUMNS)
        options = jb.measuring.MeasureOptions(camera=camera, pyramids=folder.parent / "pyramids")
        positions = jb.measuring.read_positions(DATA / "gps.csv")
        jb.measuring.measure(sorted(DATA.glob("*.jpg")), folder, options, positions=positions)
        print(f"measured in {time.perf_counter() - began:.0f} s: {folder}")
    tables = vertical_start(folder)
    distance = FOCAL / SENSOR_WIDTH * COLUMNS
    section = {
        "image_unit": "px",
        "width": COLUMNS,
        "height": ROWS,
        "principal_distance": distance,
        "principal_point": [COLUMNS / 2, ROWS / 2],
        "distortion": "metashape",
        "estimate": ["principal_distance", "x0", "y0", "K1", "K2", "P1", "P2"],
        "priors": {"principal_distance": 0.03 * distance},
    }
    camera = tables["images"]["camera"][0]
    rays = tables["rays"]
    for weights in ("of matching", "equal"):
        rays = rays if weights == "of matching" else rays.drop("sx", "sy")
        block = jb.Block.from_tables(
            cameras={camera: section},
            images=tables["images"],
            rays=rays,
            points=tables["points"],
            stations=tables["stations"],
            sigma=1.0,
            check_start=False,
        )
        began = time.perf_counter()
        result = jb.adjust(block, robust=jb.robust.Huber())
        v = np.asarray(result.residuals[0])
        print(
            f"weights {weights}: {block}\n  {time.perf_counter() - began:.0f} s, {result.status},"
            f" sigma0 {float(result.sigma0):.3f}, rms {np.sqrt(np.mean(v**2)):.3f} px,"
            f" robust {1.4826 * np.median(np.abs(v)):.3f} px"
        )
        print("  interior", dict(result.cameras[camera]))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
