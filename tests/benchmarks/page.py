"""Size of report.html, and the time to make it, for a generated block of 1200 images and 240 thousand points.

    python tests/benchmarks/page.py [strips] [images of a strip] [points of an image] [file]

With a file the page is written there, and the time that Chromium needs to show it is measured (playwright drives it).

The block is not adjusted: its residuals are drawn, its cofactors and redundancy numbers are typical ones.
"""

import sys
import time
from pathlib import Path
from shutil import which

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
jax.config.update("jax_enable_x64", True)

from cases.simulated_blocks import CAMERA  # noqa: E402

from jaxbundle.planning.simulation import simulate  # noqa: E402
from jaxbundle.report.html.page import report_html  # noqa: E402
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Iterations  # noqa: E402
from jaxbundle.solve.history import history_of  # noqa: E402
from jaxbundle.solve.options import Options  # noqa: E402


def typical(block) -> Adjustment:
    """A result as an adjustment would have it, drawn."""
    rng = np.random.default_rng(0)
    structure = block.structure
    sigmas = [np.asarray(block.rays.sigmas), *(np.asarray(group.sigmas) for group in block.groups)]
    weighted = [rng.normal(0, np.sqrt(0.8), sigma.shape) for sigma in sigmas]
    residuals = [v * sigma for v, sigma in zip(weighted, sigmas, strict=True)]
    images, points = len(structure.image_names), len(structure.point_names)
    elements = structure.interior_free.shape[1]
    variances = np.eye(3) * rng.uniform(0.5, 2.0, (points, 1, 1)) * 4e-4
    cofactors = BlockCofactors(
        jnp.asarray(np.tile(np.eye(6) * 1e-4, (images, 1, 1))),
        jnp.asarray(np.tile(np.eye(elements) * 1e-8, (len(structure.cameras), 1, 1))),
        jnp.asarray(variances),
        jnp.zeros((0, 0)),
    )
    history = history_of([(k, 1e6 / 10**k, 10.0 ** -(k + 4), 10.0**-k, True) for k in range(6)], 200)
    status, trials, accepted, *numbers = (jnp.asarray(x) for x in (1, 6, 6, 1e6, 10.0, 1e-9, 0.0))
    iterations = Iterations(status, trials, accepted, numbers[0], numbers[1], numbers[2], numbers[3], history)
    redundancy = tuple(jnp.full(sigma.shape, 0.8) for sigma in sigmas)
    arrays = tuple(map(jnp.asarray, residuals)), tuple(map(jnp.asarray, weighted))
    return Adjustment(block, *arrays, cofactors, redundancy, iterations, Options(), "panels")


def main() -> None:
    strips, images, points = (int(argument) for argument in (*sys.argv[1:4], "20", "60", "2250")[:3])
    block = simulate(
        strips,
        images,
        camera=CAMERA,
        forward_overlap=0.8,
        side_overlap=0.6,
        points_per_image=points,
        control_sigma=0.05,
        check_points=30,
        seed=1,
    ).block
    print(block)
    adjustment = jax.block_until_ready(typical(block))
    start = time.process_time(), time.perf_counter()
    page = report_html(adjustment, found=()).encode("utf-8")
    print(f"{len(page) / 1e6:.2f} MB, {time.process_time() - start[0]:.1f} s of processor time,", end=" ")
    print(f"{time.perf_counter() - start[1]:.1f} s")
    if len(sys.argv) > 4:
        Path(sys.argv[4]).write_bytes(page)
        print(f"shown in Chromium after {shown(Path(sys.argv[4]).resolve()):.2f} s")


def shown(path: Path) -> float:
    """Seconds from opening the page until its plan is drawn with all points."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1280, "height": 900})
        start = time.perf_counter()
        tab.goto(path.as_uri())
        tab.wait_for_function("document.documentElement.plan && document.documentElement.plan.places")
        seconds = time.perf_counter() - start
        browser.close()
    return seconds


if __name__ == "__main__":
    main()
