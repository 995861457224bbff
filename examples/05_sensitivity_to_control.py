"""How much does every control point hold? Derivatives of adjusted heights by the coordinates of the control.

A strip of eight photographs hangs on six weighted control points. jax.jacrev goes backwards through the whole
adjustment, by the implicit function theorem at its minimum: no iteration is differentiated. Two checks: all control
raised together raises every point as much, and one raised by half a metre does what its derivative says.

Prints a table: derivatives of the heights of check points with respect to the heights of control points.
"""

import jax
import numpy as np

import jaxbundle as jb

jax.config.update("jax_enable_x64", True)

block = jb.simulate(strips=1, images=8, control_rows=3, control_sigma=0.05, check_points=5, seed=11).block
(control,) = block.groups
names = [block.structure.point_names[k] for k in control.structure.indices[:, 0]]
check = block.structure.check_point


def heights(coordinates: jax.Array) -> jax.Array:
    """Adjusted heights of the check points as a function of the control coordinates."""
    return jb.adjust(block.replace(control=coordinates), precision=False).block.object_points[check, 2]


derivatives = np.asarray(jax.jacrev(heights)(control.values))  # check point, control point, X Y Z
by_height = derivatives[:, :, 2]

print("derivative of the height of a check point by the height of a control point")
print("            " + "".join(f"{name:>8}" for name in names))
for k, row in zip(check, by_height, strict=True):
    print(f"{block.structure.point_names[k]:12}" + "".join(f"{value:8.3f}" for value in row))
strongest = np.abs(derivatives).sum((0, 2)).argmax()
print(f"the most is held by control point {names[strongest]}")

print(f"all control raised by 1 m: check points by {by_height.sum(1).min():.9f} to {by_height.sum(1).max():.9f} m")
raised = control.values.at[strongest, 2].add(0.5)
told, done = 0.5 * by_height[:, strongest], np.asarray(heights(raised) - heights(control.values))
print(f"{names[strongest]} raised by 0.5 m: by derivative up to {np.abs(told).max():.4f} m,", end=" ")
print(f"adjusted again up to {np.abs(done).max():.4f} m, differences up to {np.abs(told - done).max():.5f} m")
