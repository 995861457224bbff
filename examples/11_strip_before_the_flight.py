"""How do errors grow along a strip, and what does control at its ends do? Laws beside the covariance of a bundle.

One strip of ten bases, three layouts of control, no measurement and no solve: jb.planning.predict gives the standard
deviation of every point. The laws of the textbook say what the free end has (n^1.5) and what tied ends leave in the
middle: a quarter where the ends hold positions, an eighth where they hold scale and azimuth too.

Prints a table of the predicted standard deviations beside the laws.
"""

import jax
import numpy as np

import jaxbundle as jb
from jaxbundle import planning as pl
from jaxbundle.textbook.accuracy_laws import BUNDLE, StripSetup, bundle_free_end, free_end, tied_middle

jax.config.update("jax_enable_x64", True)

BASES, WIDTH = 10, 48
base, half = 0.4 * 230e-3 * 1500 / 0.153, 0.4 * 230e-3 * 1500 / 0.153  # m: a base, and half a strip distance
unit = 0.005e-3 * 1500 / 0.153  # m: sigma of an image coordinate on the ground
first, second, last = ([(x * base, y) for y in (-half, half)] for x in (0, 1, BASES))
on_axis = [(x * base, 0.0) for x in (0, BASES)]
sides = [(x * base, half) for x in (0, BASES)]


def along(*control: pl.ControlSet) -> np.ndarray:
    """Standard deviations of X, Y, Z on the axis of the strip, in sigma0 m."""
    truth = pl.simulate_flight(pl.schematic(images=BASES + 1, control=control)).truth
    points = np.asarray(truth.object_points)
    axis = np.flatnonzero(np.abs(points[:, 1]) < 1)
    axis = axis[np.argsort(points[axis, 0])]
    return np.asarray(jb.planning.predict(truth).standard_deviations.object_points)[axis] / unit


def points(places: list) -> tuple:
    return tuple(map(tuple, places))


free = along(pl.ControlSet("points", points=points(first + second)))
clamped = along(pl.ControlSet("points", points=points(first + last)))
hinged = along(pl.ControlSet("points", points=points(on_axis)), pl.ControlSet("points", "height", points=points(sides)))

setup = StripSetup(1.0, 1.0, 153.0, 92.0)
middle = BASES // 2
rows = (
    ("free end, bundle", free[-1]),
    ("  its cubic in n", bundle_free_end(BASES)),
    ("  printed law", free_end(BASES, setup)),
    ("  law with the bundle's constants", free_end(BASES, setup, BUNDLE)),
    ("middle, single points, bundle", hinged[middle]),
    ("  printed law, a quarter", tied_middle(BASES, setup)),
    ("middle, pairs across the ends, bundle", clamped[middle]),
    ("  an eighth in X, Y", tied_middle(BASES, setup, BUNDLE, "clamped")),
)
print(f"{'standard deviations in sigma0 m':40}      X      Y      Z")
for name, values in rows:
    print(f"{name:40}" + "".join(f"{v:7.2f}" for v in values))

print("\nheight along the strip (o free, + single points, # pairs)")
for k in range(BASES + 1):
    line = [" "] * (WIDTH + 1)
    for mark, curve in (("o", free), ("+", hinged), ("#", clamped)):
        line[round(WIDTH * curve[k, 2] / free[:, 2].max())] = mark
    print(f"{k:3} |{''.join(line)}")
