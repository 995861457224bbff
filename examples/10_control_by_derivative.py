"""Where should five control points stand? The derivative of the predicted accuracy tells, an exchange search checks.

A block of two strips, seen by the covariance alone: nothing is measured and nothing is adjusted. The points start in
the middle of the block, one of them between the strips, which could fold about their common points without it.
jax.grad of the mean predicted variance goes back through the normal equations to their positions, and they walk as
long as the variance falls. The best five of all tie point places, found by exchange on the covariance, are the
reference, and a convex relaxation says how much better any layout could be.

Prints the gradient, the mean standard deviations of the layouts and their lower bound, and draws a picture of them.
"""

import dataclasses

import jax
import numpy as np

from jaxbundle import planning as pl

jax.config.update("jax_enable_x64", True)

base = 0.4 * 230 * 1500 / 153  # m: four tenths of an image on the ground
unit = 0.005e-3 * 1500 / 0.153  # m: sigma of an image coordinate on the ground
start = tuple((x * base, y * base) for x, y in ((1.2, 0.2), (1.2, 1.8), (2.8, 0.2), (2.8, 1.8), (2.0, 1.0)))
sigmas = (0.5 * unit,) * 3
control = pl.ControlSet("points", sigmas=sigmas, points=start)
plan = pl.schematic(strips=2, images=5, ties=pl.Ties("grid", 12), control=(control,))
truth = pl.simulate_flight(plan).truth
measure = pl.mean_variance()

found = pl.derivatives_of(truth, plan, measure)
root = found.value**0.5
print(f"start: root mean variance {root / unit:.2f} sigma0 m")
print("1 m to the outside changes it by [mm]: along and across the strips")
for k, (x, y, _) in zip(found.control, found.control_positions, strict=True):
    outwards = np.sign(np.asarray(truth.object_points)[k, :2] - np.asarray(truth.object_points)[:, :2].mean(0))
    change = 1000 * outwards * np.array([x, y]) / (2 * root)
    print(f"  point {truth.structure.point_names[k]:4}" + "".join(f"{c:9.4f}" for c in change))

moved, values = pl.steepest_positions(truth, found.control, measure, reach=0.6 * base, steps=5)
print("walk against the gradient:", " ".join(f"{v**0.5 / unit:.2f}" for v in values))

free = pl.simulate_flight(dataclasses.replace(plan, control=())).truth
candidates = pl.candidates_of(free, np.arange(len(free.structure.point_names)), sigmas)
layout = pl.best_layout(candidates, len(start))
bound = layout.bound**0.5
print(
    f"exchange over {len(candidates.points)} places: {layout.objective**0.5 / unit:.2f}, lower bound {bound / unit:.2f}"
)
print("picture (o tie point, C control by exchange, + control after the walk)")
xy = np.asarray(free.object_points)[:, :2]
low, size = xy.min(0), np.ptp(xy, axis=0)
picture = [[" "] * 61 for _ in range(15)]
for mark, places in (
    ("o", xy),
    ("C", xy[layout.points]),
    ("+", np.asarray(moved.object_points)[found.control, :2]),
):
    for column, row in np.clip(np.round((places - low) / size * [60, 14]), 0, [60, 14]).astype(int):
        picture[14 - row][column] = mark
print("\n".join("".join(row).rstrip() for row in picture))
