"""What does a single ray do? Leave-one-out by derivative, and by adjusting again without it.

A ray has no influence where its measurement is so changed that its own residual vanishes. With derivatives of the
adjustment by the measured coordinates l_i of ray i, v_i its residual and T a target, here a tie point,

    v_i + (dv_i/dl_i) dl = 0,      T without ray i  =  T + (dT/dl_i) dl

-dv_i/dl_i are the two by two redundancy numbers of the ray: where they are near 0 nothing controls it.

Prints a table: the effect of each ray by its derivative, and by adjusting again without it.
"""

import jax
import numpy as np

import jaxbundle as jb
from jaxbundle.block.changes import without_ray

jax.config.update("jax_enable_x64", True)

block = jb.simulate(strips=1, images=5, control_sigma=0.05, points_per_image=30, check_points=0, seed=6).block
structure = block.structure
count = np.bincount(structure.ray_point)
control = block.groups[0].structure.indices[:, 0]
target = int(np.setdiff1d(np.flatnonzero(count == 3), control)[0])


def residuals_and_target(coordinates: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Residuals of all rays and the target's coordinates, by the measured coordinates."""
    result = jb.adjust(block.replace(image_coordinates=coordinates), precision=False)
    return result.residuals[0], result.block.object_points[target]


measured = block.rays.coordinates
result = jb.adjust(block, precision=False)
by_residuals, by_target = jax.jacfwd(residuals_and_target)(measured)  # (ray, 2, ray, 2) and (3, ray, 2)

# rays of points on three images or more: without one of them the point is still there
rays = np.flatnonzero(count[structure.ray_point] > 2)
redundancy = -np.asarray(by_residuals)[rays, :, rays, :]
change = np.linalg.solve(redundancy, np.asarray(result.residuals[0])[rays][:, :, None])
told = np.einsum("tri,ri->rt", np.asarray(by_target)[:, rays], change[:, :, 0])

again = [jb.adjust(without_ray(result.block, int(ray)), precision=False) for ray in rays]
done = np.array([a.block.object_points[target] - result.block.object_points[target] for a in again])

off = np.linalg.norm(told - done, axis=1) / np.linalg.norm(done, axis=1)
print(f"point {structure.point_names[target]}, {len(rays)} of {len(structure.ray_image)} rays left out one by one")
print("ray                moves the point by [mm]: told by derivative     adjusted again")
for k in np.argsort(-np.linalg.norm(done, axis=1))[:5]:
    image, point = (
        structure.image_names[structure.ray_image[rays[k]]],
        structure.point_names[structure.ray_point[rays[k]]],
    )
    vectors = ("  ".join(f"{1000 * x:6.1f}" for x in vector) for vector in (told[k], done[k]))
    print(f"image {image} point {point:8}" + "     ".join(f"{v:>30}" for v in vectors))
print(f"{100 * np.mean(off < 0.05):.0f}% of the rays agree within 5%, the median within {100 * np.median(off):.2f}%")
