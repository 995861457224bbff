"""Ten thousand windows matched: python tests/benchmarks/matching.py [--windows N]

Least-squares matching in one call against OpenCV's ECC and pyramidal Lucas-Kanade on the same windows: time, bias and
scatter. The images are one real photograph (../shared/data/images/copr) decimated by 8 from shifted pixels, so that the
shifts are known exactly, with noise of one grey value. Needs `pip install -e .[benchmarks,measure]`.
"""

import argparse
import sys
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

import cv2  # noqa: E402  # pyright: ignore[reportMissingImports]
import numpy as np  # noqa: E402
from cases.textures import box, cut, grey_image, interest_points  # noqa: E402
from table import print_machine  # noqa: E402

from jaxbundle.imagery.match_types import MatchOptions  # noqa: E402
from jaxbundle.imagery.matching import match  # noqa: E402

IMAGE = Path(__file__).parents[3] / "shared" / "data" / "images" / "copr" / "IMG_0052.jpg"
HALF, MARGIN, SHIFT, DECIMATED = 10, 12, 4, 8  # px; the shift is SHIFT / DECIMATED


def told(name: str, seconds: float, x: np.ndarray, y: np.ndarray) -> None:
    """One line: time, bias and scatter along the shift, and the robust scatter of both."""
    both = np.concatenate([x, y])
    robust = 1.4826 * np.median(np.abs(both - np.median(both)))
    print(f"{name:28} {seconds:8.2f} s  {len(x):6d}  bias {x.mean():+.4f}  sd {x.std():.4f}  robust {robust:.4f} px")


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--windows", type=int, default=10_000)
    number = parser.parse_args().windows
    print_machine(None)
    image, rng = grey_image(IMAGE), np.random.default_rng(0)
    first, second = box(image, DECIMATED, 0), box(image, DECIMATED, SHIFT)
    first, second = (g + rng.standard_normal(g.shape) for g in (first, second))
    rows, columns = interest_points(first, 3, HALF + MARGIN + 2, number)
    chosen = np.arange(number) % len(rows)
    rows, columns = rows[chosen], columns[chosen]
    templates, searched = cut(first, rows, columns, HALF), cut(second, rows, columns, HALF + MARGIN)
    middle, true = HALF + MARGIN + 0.5, -SHIFT / DECIMATED
    starts = np.tile([middle, 1.0, 0.0, middle, 0.0, 1.0], (number, 1))
    references = np.full((number, 2), HALF + 0.5)
    for parameters in ("affine", "shift", "tested"):
        options = MatchOptions(parameters=parameters)
        match(templates[:2], searched[:2], references[:2], starts[:2], options)  # compiles
        began = time.perf_counter()
        found = match(templates, searched, references, starts, options)
        seconds = time.perf_counter() - began
        shift = (np.asarray(found.position) - middle)[found.matched]
        told(f"least squares, {parameters}", seconds, shift[:, 0] - true, shift[:, 1])
    one, other = (np.clip(np.round(g), 0, 255).astype(np.uint8) for g in (first, second))
    points = np.stack([columns, rows], 1).astype(np.float32)
    began = time.perf_counter()
    moved, status, _ = cv2.calcOpticalFlowPyrLK(one, other, points, points.copy(), winSize=(21, 21), maxLevel=3)
    shift = (moved - points)[status.ravel() == 1]
    told("OpenCV Lucas-Kanade", time.perf_counter() - began, shift[:, 0] - true, shift[:, 1])
    criteria, found_by_ecc = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-5), []
    whole = np.full(searched.shape[1:], 255, np.uint8)
    began = time.perf_counter()
    for f, g in zip(templates.astype(np.float32), searched.astype(np.float32), strict=True):
        warp = np.array([[1, 0, MARGIN], [0, 1, MARGIN]], np.float32)
        try:
            cv2.findTransformECC(f, g, warp, cv2.MOTION_AFFINE, criteria, whole, 1)
        except cv2.error:
            continue
        found_by_ecc.append(warp @ [HALF, HALF, 1] - (HALF + MARGIN))
    seconds = time.perf_counter() - began
    shift = np.array(found_by_ecc)
    shift = shift[np.abs(shift).max(1) < 3]
    told("OpenCV ECC, affine", seconds, shift[:, 0] - true, shift[:, 1])


if __name__ == "__main__":
    main()
