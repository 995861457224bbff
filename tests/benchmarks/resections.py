"""Times space resections against OpenCV: python tests/benchmarks/resections.py [--images N] [--points N]

All images by one vmapped call, from nothing, against a Python loop over cv2.solvePnP (SOLVEPNP_ITERATIVE: a direct
solution, then Levenberg-Marquardt), on the same machine in turn; the least of several rounds. Needs
`pip install -e .[benchmarks]`. Ours gives cofactors and residuals as well.
"""

import argparse
import sys
import time
from collections.abc import Callable

import jax

jax.config.update("jax_enable_x64", True)

import cv2  # noqa: E402  # pyright: ignore[reportMissingImports]
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from table import print_machine  # noqa: E402

import jaxbundle as jb  # noqa: E402
from jaxbundle.geometry.rotation import from_omega_phi_kappa  # noqa: E402

PRINCIPAL_DISTANCE, HEIGHT, NOISE = 5000.0, 1500.0, 0.5  # px, m, px
ROUNDS, REPEATED = 5, 3  # the first call after the other one finds cold caches


def scene(images: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Object points and image coordinates (y up) of near-vertical images in all azimuths."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (points, 3, images)) * np.array([500.0, 500.0, 80.0])[:, None]
    angles = rng.normal(0, 0.05, (3, images)) + np.array([[0.0], [0.0], [1.0]]) * rng.uniform(-3, 3, images)
    centre = np.array([[0.0], [0.0], [HEIGHT]]) + rng.normal(0, 50, (3, images))
    rotation = from_omega_phi_kappa(*angles)
    on_x, on_y, on_z = jnp.asarray(x).swapaxes(0, 1)
    xy = jb.collinearity(rotation, tuple(centre), (on_x, on_y, on_z), PRINCIPAL_DISTANCE)
    measured = np.stack(xy) + NOISE * rng.standard_normal((2, points, images))
    return np.ascontiguousarray(x.transpose(2, 0, 1)), np.ascontiguousarray(measured.transpose(2, 1, 0))


def opencv(points: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Projection centres, one image after the other; OpenCV's y points down and its camera looks along +z."""
    matrix, down = np.diag([PRINCIPAL_DISTANCE, PRINCIPAL_DISTANCE, 1.0]), measured * [1.0, -1.0]
    centres = np.empty((len(points), 3))
    for k in range(len(points)):
        _, turn, shift = cv2.solvePnP(points[k], down[k], matrix, None, flags=cv2.SOLVEPNP_ITERATIVE)
        centres[k] = (-cv2.Rodrigues(turn)[0].T @ shift)[:, 0]
    return centres


def least(functions: list[Callable[[], object]]) -> list[float]:
    """Least seconds of each, in turn."""
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(ROUNDS):
        for function, seconds in zip(functions, times, strict=True):
            for _ in range(REPEATED):
                start = time.perf_counter()
                function()
                seconds.append(time.perf_counter() - start)
    return [min(seconds) for seconds in times]


def main() -> int:
    """Command line; exit code 1 where the results differ."""
    parser = argparse.ArgumentParser(description="Times space resections against OpenCV.")
    parser.add_argument("--images", type=int, default=10_000)
    parser.add_argument("--points", type=int, default=6)
    options = parser.parse_args()
    points, measured = scene(options.images, options.points)
    model, interior = jb.cameras.CAMERA_MODELS["none"], np.array([PRINCIPAL_DISTANCE, 0.0, 0.0, 1.0, 1.0])
    program = jax.jit(jax.vmap(lambda x, xy: jb.orientation.resection(model, interior, x, xy)))
    start = time.perf_counter()
    found = jax.block_until_ready(program(points, measured))
    first = time.perf_counter() - start
    centres = opencv(points, measured)

    print_machine(None)
    ours, theirs = least(
        [lambda: jax.block_until_ready(program(points, measured)), lambda: opencv(points, measured)],
    )
    deviations = np.asarray(found.standard_deviations)[:, :3]
    difference = np.abs(np.asarray(found.projection_centre) - centres)
    print(f"\n{options.images} resections of {options.points} points; OpenCV {cv2.__version__}")
    print(f"  {'jaxbundle, vmapped':22} {1e3 * ours:9.1f} ms  {1e6 * ours / options.images:8.2f} us each")
    print(f"  {'OpenCV, Python loop':22} {1e3 * theirs:9.1f} ms  {1e6 * theirs / options.images:8.2f} us each")
    print(f"  ratio {theirs / ours:.1f}; first call with compilation {first:.1f} s")
    print(f"  converged {int(found.converged.sum())} of {options.images}, at most {int(found.iterations.max())} steps")
    above = centres[:, 2] > 0
    print(f"  OpenCV has the camera below the ground in {(~above).sum()}; in the others the largest difference of the")
    print(
        f"  projection centres is {difference[above].max():.1e} m, or {(difference / deviations)[above].max():.1e} of"
        " its standard deviation"
    )
    return 0 if bool(found.converged.all()) else 1


if __name__ == "__main__":
    sys.exit(main())
