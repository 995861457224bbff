"""Weights tuned by known points: the gradient of their errors by the sigmas of the rays.

Three strips were flown in different light. All are said to be measured to 6 micrometres; in truth the second one is
four times worse than the first, and the third one twice. The logarithms of the two ratios follow the gradient of the
known points' mean square error, through the whole adjustment, downhill. Every other known point only tests.

Prints a table: errors of the test points with the given, the tuned and the true sigmas.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import jaxbundle as jb
from jaxbundle.planning.simulation import exact_coordinates

jax.config.update("jax_enable_x64", True)

TRUE = np.array([4.0, 2.0])  # sigmas of the second and of the third strip over that of the first
SIGMA = 0.006  # mm

rng = np.random.default_rng(8)
block = jb.simulate(
    strips=3, images=5, side_overlap=0.6, control_rows=3, control_sigma=0.02, check_points=0, seed=4
).truth
known = block.object_points
strip = np.array([int(name[0]) - 1 for name in block.structure.image_names])[block.structure.ray_image]
errors = SIGMA * np.append(1.0, TRUE)[strip][:, None] * rng.normal(size=(len(strip), 2))
block = block.replace(image_coordinates=exact_coordinates(block)[0] + errors)

tie = np.setdiff1d(np.arange(len(known)), block.groups[0].structure.indices[:, 0])
train, test = tie[::2], tie[1::2]


def error(logarithms: jax.Array, points: np.ndarray) -> jax.Array:
    """Mean square of the errors of known points, in cm^2."""
    sigmas = SIGMA * jnp.exp(jnp.append(0.0, logarithms))[strip][:, None] * jnp.ones(2)
    adjusted = jb.adjust(block.replace(sigmas={"rays": sigmas}), precision=False).block.object_points
    return jnp.mean((100 * (adjusted - known)[points]) ** 2)


gradient = jax.value_and_grad(lambda logarithms: error(logarithms, train))
tuned = minimize(lambda t: [np.asarray(x) for x in gradient(jnp.asarray(t))], np.zeros(2), jac=True)
print("          second strip  third strip   rms error of known points [cm]: that tune, that test")
for name, ratio in (("as said", np.ones(2)), ("tuned", np.exp(tuned.x)), ("true", TRUE)):
    rms = [float(error(jnp.log(ratio), points)) ** 0.5 for points in (train, test)]
    print(f"{name:10}{ratio[0]:12.2f}{ratio[1]:13.2f}{rms[0]:14.3f}{rms[1]:10.3f}")
