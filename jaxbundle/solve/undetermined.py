"""Which unknowns the observations leave undetermined, in the user's names, with what would determine them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.normals import schur
from jaxbundle.normals.cofactors import Cofactors
from jaxbundle.solve.levenberg_marquardt import Arguments

WEAKEST_SHARE = 1e-11  # of its own normal equation: below, rounding decides about the unknown
CURES = {
    "image": "measure more and better spread points on the image, or add control",
    "camera": "hold the element, give control in relief, or add convergent and turned images",
    "point": "measure the point on one more image from elsewhere, give it coordinates or drop it",
}


def undetermined_unknowns(block: Block, unknowns: Unknowns, args: Arguments, cofactors: Cofactors) -> tuple[str, ...]:
    """One sentence for each direction in which the unknowns can move without any observation noticing."""
    shares = np.asarray(cofactors.point_pivots)
    loose = [block.structure.point_names[p] for p in np.nonzero(~(shares > WEAKEST_SHARE))[0]]
    sentences = [f"point {name}; {CURES['point']}" for name in loose]
    if np.all(np.asarray(cofactors.kept_pivots) > WEAKEST_SHARE):
        return tuple(sentences)
    matrix = np.asarray(_scaled_reduced(unknowns, args))
    if not np.isfinite(matrix).all():
        return tuple(sentences)
    values, vectors = np.linalg.eigh(matrix)
    names = _kept_names(block, args)
    for vector in vectors.T[values <= WEAKEST_SHARE]:
        large = np.argsort(-np.abs(vector), kind="stable")[:6]
        large = [k for k in large if abs(vector[k]) > 0.3 * np.abs(vector).max()]
        moved = ", ".join(names[k][1] for k in large)
        sentences.append(f"{moved} (together); {CURES[names[large[0]][0]]}")
    return tuple(sentences)


@eqx.filter_jit
def _scaled_reduced(unknowns: Unknowns, args: Arguments) -> Float[Array, "kept kept"]:
    """The undamped reduced matrix scaled to the unit diagonal of N; held unknowns have a unit row."""
    observations, plan, _ = args
    e = schur.eliminate(schur.tables(unknowns, observations), plan, jnp.asarray(0.0))
    free = schur.free_columns(observations, plan) & (e.diagonal > 0)
    scale = jnp.where(free, 1 / jnp.sqrt(jnp.where(free, e.diagonal, 1.0)), 0.0)
    held = ~schur.free_columns(observations, plan)
    return scale[:, None] * e.reduced * scale[None, :] + jnp.diag(jnp.where(held, 1.0, 0.0))


def _kept_names(block: Block, args: Arguments) -> list[tuple[str, str]]:
    """Kind and name of every kept unknown, in the order of the columns."""
    structure = block.structure
    images = [
        ("image", f"{element} of image {name}")
        for name in structure.image_names
        for element in structure.exterior_elements
    ]
    cameras = [
        ("camera", f"{camera.model.elements[k] if k < len(camera.model.elements) else k} of camera {camera.name}")
        for camera in structure.cameras
        for k in structure.interior_columns
    ]
    kept = np.asarray(args.plan.kept_point)
    points = [("point", f"{c} of point {structure.point_names[p]}") for p in kept for c in "XYZ"]
    return images + cameras + points
