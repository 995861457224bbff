"""Order of accuracy of the methods on simulated blocks with known truth.

    python tests/benchmarks/methods.py [DRAWS]

For each method: root mean square errors of the tie points that all methods determine, their standard deviations as
reported (models and strips: by propagation of the errors of the image coordinates), and the scatter over these.
"""

import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from cases.noise import with_noise  # noqa: E402

import jaxbundle as jb  # noqa: E402
from jaxbundle.cli import runtime  # noqa: E402

METHODS = ("bundle", "models with shared errors", "models", "strips, degree 2", "strips, conformal")


def adjusted(method: str, block: jb.Block, first: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, float]:
    """Points, their coordinates, standard deviations (of the first draw only) and sigma0."""
    if method == "bundle":
        found = jb.adjust(block)
        every = np.arange(len(block.structure.point_names))
        sd = np.asarray(found.standard_deviations.object_points) / float(found.sigma0)
        return every, np.asarray(found.block.object_points), sd, float(found.sigma0)
    if method.startswith("models"):
        result = jb.independent.adjust_models(block, estimate_shared_errors="shared" in method)
    else:
        result = jb.independent.adjust_strips(block, form="conformal" if "conformal" in method else "separate")
    deviations = None
    if first:
        precision = result.propagated()
        assert precision is not None
        deviations = precision.standard_deviations.object_points[: len(result.points)] / precision.sigma0
    return result.points, result.object_points, deviations, float(result.adjustment.sigma0)


def main(draws: int) -> None:
    """Prints the table."""
    runtime.start()
    simulation = jb.simulate(2, 7, control_sigma=0.02, points_per_image=30, control_rows=4, seed=1)
    truth = np.asarray(simulation.truth.object_points)
    errors, deviations = {}, {}
    for method in METHODS:
        errors[method] = np.full((draws, *truth.shape), np.nan)
        deviations[method] = np.full(truth.shape, np.nan)
        sigmas = []
        for draw in range(draws):
            points, x, sd, sigma0 = adjusted(method, with_noise(simulation, draw), draw == 0)
            errors[method][draw, points] = x - truth[points]
            sigmas.append(sigma0)
            if sd is not None and draw == 0:
                deviations[method][points] = sd
        print(method, "sigma0", np.mean(sigmas), flush=True)
    common = np.all([np.isfinite(e).all((0, 2)) for e in errors.values()], 0)
    common &= np.bincount(simulation.truth.structure.ray_point, minlength=len(truth)) > 2
    print(f"{draws} draws, {common.sum()} points")
    print("| method | rms error X, Y, Z [m] | reported sd X, Y, Z [m] | error/sd | mean error/its sd |")
    print("|---|---|---|---|---|")
    for method in METHODS:
        e, sd = errors[method][:, common], deviations[method][common]
        ratio = e / sd
        rms, mean_sd = np.sqrt(np.mean(e**2, (0, 1))), np.sqrt(np.mean(sd**2, 0))
        bias = np.sqrt(np.mean(ratio.mean(0) ** 2) * draws)
        numbers = [", ".join(f"{v:.3f}" for v in values) for values in (rms, mean_sd)]
        print(f"| {method} | {numbers[0]} | {numbers[1]} | {np.sqrt(np.mean(ratio**2)):.2f} | {bias:.2f} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
