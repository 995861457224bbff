"""A lens is learned: a spline inside the image equation, trained by the errors of check points.

The camera of two strips bends its rays by a radial curve that no model describes. Its camera model here is the central
projection with that curve as a spline of six numbers, which are held in every adjustment and improved between two of
them: the gradient of the check points' errors goes back through the whole adjustment. Points that neither train nor
control tell whether the lens was learned or the check points by heart.

Prints a table: errors of training and test points without, with the learned and with the true distortion.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import jaxbundle as jb
from jaxbundle.planning.simulation import exact_coordinates

jax.config.update("jax_enable_x64", True)

C, LARGEST, KNOTS, SIGMA = 150.0, 1.2, 6, 0.003  # mm, r / c at the last knot, numbers of the spline, mm
names = tuple(f"s{k}" for k in range(KNOTS))


def bump(u):
    """The uniform cubic B-spline about 0, of width 4."""
    a = jnp.abs(u)
    return jnp.where(a < 1, 2 / 3 - a**2 + a**3 / 2, jnp.where(a < 2, (2 - jnp.clip(a, 0, 2)) ** 3 / 6, 0.0))


def spline_camera(interior, vector, measured):
    """v = computed - observed, y up; the spline's numbers are in thousandths of the radius."""
    c, x0, y0, *numbers = interior
    x, y = -vector[0] / vector[2], -vector[1] / vector[2]
    r = jnp.sqrt(x**2 + y**2 + 1e-12)
    curve = sum(s * bump(r / LARGEST * (KNOTS - 1) - k) for k, s in enumerate(numbers))
    return x0 + c * x * (1 + 1e-3 * curve) - measured[0], y0 + c * y * (1 + 1e-3 * curve) - measured[1]


# a simulated block gets the new camera, true numbers, and rays as that camera sees them
rng = np.random.default_rng(2)
block = jb.simulate(strips=2, images=5, control_rows=3, control_sigma=0.02, check_points=0, seed=3).truth
model = jb.cameras.CameraModel("spline", ("principal_distance", "x0", "y0", *names), spline_camera)
camera = dataclasses.replace(block.structure.cameras[0], model=model, image_unit="mm", principal_distance_in_mm=False)
held = np.zeros((1, 3 + KNOTS), bool)
structure = dataclasses.replace(block.structure, cameras=(camera,), interior_free=held)
true = jnp.array([[C, 0.0, 0.0, 0.0, 0.05, 0.25, 0.45, 0.4, 0.1]])
shape = block.rays.coordinates.shape
block = dataclasses.replace(block, structure=structure, interior=jb.blocks.InteriorOrientation(true))
block = block.replace(sigmas={"rays": SIGMA})
block = block.replace(image_coordinates=exact_coordinates(block)[0] + SIGMA * rng.normal(size=shape))

# half of the tie points are known: they train; the others test
tie = np.setdiff1d(np.arange(len(block.object_points)), block.groups[0].structure.indices[:, 0])
train, test = tie[::2], tie[1::2]


def errors(numbers, points):
    """Mean square of the points' errors [mm^2] after an adjustment with these numbers."""
    result = jb.adjust(block.replace(interior=true.at[0, 3:].set(numbers)), precision=False)
    return jnp.mean((1000 * (result.block.object_points - block.object_points)[points]) ** 2)


gradient = jax.value_and_grad(lambda numbers: errors(numbers, train))
learned = minimize(lambda s: [np.asarray(x) for x in gradient(s)], np.zeros(KNOTS), jac=True, options={"maxiter": 25})
for name, numbers in (("no distortion", np.zeros(KNOTS)), ("learned", learned.x), ("true", true[0, 3:])):
    rms = [float(errors(numbers, points)) ** 0.5 for points in (train, test)]
    print(f"{name:14} rms error of training points {rms[0]:6.1f} mm, of test points {rms[1]:6.1f} mm")
