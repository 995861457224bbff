"""A whole bundle adjustment with plain parts: the image equation, automatic derivatives and dense normal equations.

Six photographs, 25 ground points, of which four are control points. Unknown: six elements an image, three coordinates a
tie point, all in one vector x. v = computed - observed, and one Gauss-Newton step solves J^T P J d = -J^T P v.

Prints sigma0 and a table of the first photograph: values, standard deviations and true errors.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbundle.camera.collinearity import collinearity
from jaxbundle.geometry.rotation import from_omega_phi_kappa

jax.config.update("jax_enable_x64", True)

C, SIGMA = 153.0, 0.005  # principal distance and standard deviation of an image coordinate [mm]
rng = np.random.default_rng(3)

# The truth: two strips of three images 1500 m above a 5 x 5 grid of ground points [m]
centres = np.array([[x, y, 1500.0] for y in (300, 900) for x in (0, 600, 1200)])
angles = rng.normal(0, 0.03, (6, 3))
ground = np.array([[x, y, 0.0] for y in np.linspace(0, 1200, 5) for x in np.linspace(0, 1200, 5)])
ground[:, 2] = rng.uniform(0, 150, 25)
control, tie = [0, 4, 20, 24], [k for k in range(25) if k not in (0, 4, 20, 24)]
image, point = (grid.ravel() for grid in np.meshgrid(np.arange(6), np.arange(25), indexing="ij"))  # every ray


def image_points(x):
    """Computed image coordinates of all rays, one vector."""
    exterior, points = x[:36].reshape(6, 6), jnp.asarray(ground).at[jnp.array(tie)].set(x[36:].reshape(-1, 3))
    rotation = from_omega_phi_kappa(*exterior[image, 3:].T)
    return jnp.concatenate(collinearity(rotation, tuple(exterior[image, :3].T), tuple(points[point].T), C))


truth = np.concatenate([np.hstack([centres, angles]).ravel(), ground[tie].ravel()])
observed = image_points(truth) + SIGMA * rng.standard_normal(2 * len(image))
rough = np.concatenate([np.tile([20.0] * 3 + [0.02] * 3, 6), np.full(3 * len(tie), 20.0)])
x = truth + rough * rng.standard_normal(len(truth))  # approximate values


@jax.jit
def linearised(x):
    """Residuals and their derivatives, both over sigma: P = I / SIGMA^2 is in them."""
    return (image_points(x) - observed) / SIGMA, jax.jacfwd(image_points)(x) / SIGMA


v, j = map(np.asarray, linearised(x))
for iteration in range(1, 21):
    d = np.linalg.solve(j.T @ j, -j.T @ v)
    angle = np.linalg.norm(j @ d) / np.linalg.norm(v)
    x = x + d
    v, j = map(np.asarray, linearised(x))
    print(f"iteration {iteration}: vTPv {v @ v:14.4f}  |J d| / |v| {angle:.1e}")
    if angle < 1e-8:
        break

redundancy = len(v) - len(x)
sigma0 = np.sqrt(v @ v / redundancy)
sd = sigma0 * np.sqrt(np.diag(np.linalg.inv(j.T @ j)))
print(f"observations {len(v)}, unknowns {len(x)}, redundancy {redundancy}, sigma0 {sigma0:.4f}")
for k, name in enumerate(("X0", "Y0", "Z0", "omega", "phi", "kappa")):
    print(f"image 1 {name:6}{x[k]:14.6f}  sd {sd[k]:.6f}  true error {x[k] - truth[k]:+.6f}")
size = np.abs(x - truth) / sd
print(f"true errors over standard deviations: rms {np.sqrt(np.mean(size**2)):.2f}, largest {size.max():.2f}")
