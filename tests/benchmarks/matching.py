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
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))

import cv2  # noqa: E402  # pyright: ignore[reportMissingImports]
import numpy as np  # noqa: E402
from cases.textures import box, cut, grey_image, interest_points  # noqa: E402
from table import print_machine  # noqa: E402

from jaxbundle.imagery import spline  # noqa: E402
from jaxbundle.imagery.match_types import MatchOptions  # noqa: E402
from jaxbundle.imagery.matching import match  # noqa: E402

IMAGE = Path(__file__).parents[3] / "shared" / "data" / "images" / "copr" / "IMG_0052.jpg"
HALF, MARGIN, SHIFT, DECIMATED = 10, 12, 4, 8  # px; the shift is SHIFT / DECIMATED
ENOUGH = 1200  # windows of 21 x 21 from which matching uses its optimised program


class Clock:
    """Wall time and processor time since its construction."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __str__(self) -> str:
        return f"{time.perf_counter() - self._wall:7.2f} s  CPU {time.process_time() - self._cpu:6.2f} s"


def told(name: str, clock: str, x: np.ndarray, y: np.ndarray) -> None:
    """One line: time, bias and scatter along the shift, and the robust bias and scatter."""
    both = np.concatenate([x, y])
    robust = 1.4826 * np.median(np.abs(both - np.median(both)))
    print(
        f"{name:24} {clock}  {len(x):6d}  bias {x.mean():+.4f}  median {np.median(x):+.4f}"
        f"  sd {x.std():.4f}  robust {robust:.4f} px",
        flush=True,
    )


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--windows", type=int, default=10_000)
    number = parser.parse_args().windows
    print_machine(None)
    image, rng = grey_image(IMAGE), np.random.default_rng(0)
    second = box(image, DECIMATED, SHIFT)
    first = box(image, DECIMATED, 0)[:, : second.shape[1]]
    first, second = (g + rng.standard_normal(g.shape) for g in (first, second))
    rows, columns = interest_points(first, 3, HALF + MARGIN + 2, number)
    chosen = np.arange(number) % len(rows)
    print(f"{number} windows of {2 * HALF + 1} x {2 * HALF + 1} px at {len(rows)} interest points")
    rows, columns = rows[chosen], columns[chosen]
    templates, searched = cut(first, rows, columns, HALF), cut(second, rows, columns, HALF + MARGIN)
    middle, true = HALF + MARGIN + 0.5, -SHIFT / DECIMATED
    starts = np.tile([middle, 1.0, 0.0, middle, 0.0, 1.0], (number, 1))
    references = np.full((number, 2), HALF + 0.5)
    for parameters in ("affine", "shift", "tested"):
        options = MatchOptions(parameters=parameters)
        few = np.arange(min(number, ENOUGH))
        match(templates[few], searched[few], references[few], starts[few], options)  # compiles the optimised program
        clock = Clock()
        found = match(templates, searched, references, starts, options)
        taken = str(clock)
        shift = (np.asarray(found.position) - middle)[found.matched]
        told(f"least squares, {parameters}", taken, shift[:, 0] - true, shift[:, 1])
    one, other = (np.clip(np.round(g), 0, 255).astype(np.uint8) for g in (first, second))
    points = np.stack([columns, rows], 1).astype(np.float32)
    clock = Clock()
    moved, status, _ = cv2.calcOpticalFlowPyrLK(one, other, points, points.copy(), winSize=(21, 21), maxLevel=3)
    taken, shift = str(clock), (moved - points)[status.ravel() == 1]
    told("OpenCV Lucas-Kanade", taken, shift[:, 0] - true, shift[:, 1])
    clock = Clock()
    shift = by_ecc(templates.astype(np.float32), searched.astype(np.float32))
    told("OpenCV ECC, affine", str(clock), shift[:, 0] - true, shift[:, 1])
    at_points(second, number)


def by_ecc(templates: np.ndarray, searched: np.ndarray) -> np.ndarray:
    """Shifts of the windows that OpenCV's ECC matches."""
    criteria, found = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-5), []
    whole = np.full(searched.shape[1:], 255, np.uint8)
    for f, g in zip(templates, searched, strict=True):
        warp = np.array([[1, 0, MARGIN], [0, 1, MARGIN]], np.float32)
        try:
            cv2.findTransformECC(f, g, warp, cv2.MOTION_AFFINE, criteria, whole, 1)
        except cv2.error:
            continue
        found.append(warp @ [HALF, HALF, 1] - (HALF + MARGIN))
    shift = np.array(found)
    return shift[np.abs(shift).max(1) < 3]


def at_points(image: np.ndarray, number: int) -> None:
    """Time of grey values with their derivatives at many points of one image, by the cubic spline."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(20, 300, (2, number))
    surface = spline.coefficients(jnp.asarray(image[:320, :320]))

    def value(x: jax.Array, y: jax.Array) -> jax.Array:
        return spline.value(surface, x, y)

    program = jax.jit(jax.vmap(jax.value_and_grad(value, (0, 1))))
    jax.block_until_ready(program(x, y))
    clock = Clock()
    jax.block_until_ready(program(x, y))
    print(f"spline and its gradient at {number} points: {clock}")


if __name__ == "__main__":
    main()
