"""A kind of observation of one's own: the shore of a lake lies at one height, which nobody knows.

A strip of ten photographs along a lake has control at both ends only, so its heights sag in the middle. Every tie point
on the shore is now observed to lie at the level of the water, one more unknown, to 0.05 m. The residual is all there is
to write: computed - observed, a function of scalars, of which automatic derivatives make the rows of the adjustment.

Prints a table: standard deviations and true errors of the heights, without and with the lake.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import jaxbundle as jb

jax.config.update("jax_enable_x64", True)

# A flat shore: the truth of every height is 0
simulation = jb.simulate(strips=1, images=10, relief=0.0, control_rows=2, control_sigma=0.05, check_points=0, seed=5)
block, truth = simulation.block, simulation.truth

# The new kind of observation: what it is called, what it touches, and its residual. Coordinates are centred while they
# are adjusted; a constant called Z moves along, so the level counts from Z = 0 whatever the origin is.
water_level = jb.observations.ObservationKind(
    name="water_level",
    components=("height",),
    touches=("point", "parameter"),
    residual=lambda point, level, observed, constants: (point[2] - constants[0] - level - observed[0],),
    constants=("Z",),
)

# Every sixth tie point is on the shore; members are (point, parameter), observed is 0, to 0.05 m
control = np.concatenate([group.structure.indices[:, 0] for group in block.groups])
shore = np.setdiff1d(np.arange(len(block.structure.point_names)), control)[::6]
members = np.stack([shore, np.zeros_like(shore)], 1)
zero = np.zeros((len(shore), 1))
group = jb.observations.observation_group(water_level, members, values=zero, sigmas=zero + 0.05, constants=zero)
structure = dataclasses.replace(block.structure, parameters=(jb.blocks.Parameter("level of the lake", "m"),))
level = jnp.array([2.0])  # approximate value
with_lake = dataclasses.replace(block, structure=structure, groups=(*block.groups, group), parameters=level)

print("heights of tie points off the shore [m]: standard deviation and true error, root mean squares")
others = np.setdiff1d(np.arange(len(block.structure.point_names)), [*control, *shore])
for name, each in (("without the lake", block), ("with the lake", with_lake)):
    result = jb.adjust(each)
    sd = np.asarray(result.standard_deviations.object_points)[others, 2]
    error = np.asarray(result.block.object_points - truth.object_points)[others, 2]
    print(f"{name:17} sd {np.sqrt(np.mean(sd**2)):.3f}  error {np.sqrt(np.mean(error**2)):.3f}")

level, sd = float(result.block.parameters[0]), float(result.standard_deviations.parameters[0])
print(f"level of the lake {level:+.3f} m, sd {sd:.3f}, true value 0; {len(shore)} points on its shore")
print(f"residuals of the shore up to {np.abs(result.residuals[-1]).max():.3f} m, sigma0 {float(result.sigma0):.3f}")
