"""A first block: a strip with known truth is simulated, adjusted and compared with the truth.

Prints the summary and a table of the projection centres: values, standard deviations and true errors.
"""

import jax
import numpy as np

import jaxbundle as jb

jax.config.update("jax_enable_x64", True)  # an adjustment needs double precision

simulation = jb.simulate(strips=1, images=6, control_rows=3, control_sigma=0.05, seed=7)
result = jb.adjust(simulation.block)
print(result.summary())

found, truth, sd = result.block, simulation.truth, result.standard_deviations
print("\nProjection centres, standard deviations and true errors [m]")
for name, centre, deviation, true in zip(
    found.structure.image_names,
    np.asarray(found.exterior.projection_centre),
    np.asarray(sd.projection_centre),
    np.asarray(truth.exterior.projection_centre),
    strict=True,
):
    numbers = "".join(
        f"  {v:10.3f} +- {s:.3f} ({e:+.3f})" for v, s, e in zip(centre, deviation, centre - true, strict=True)
    )
    print(f"{name}{numbers}")

size = np.abs(found.object_points - truth.object_points) / sd.object_points
print(f"\n{np.mean(size < 2):.0%} of the object coordinates are within 2 standard deviations of the truth")
