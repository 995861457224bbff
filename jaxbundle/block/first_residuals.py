"""Checking the residuals of a user's camera model at the approximate values: numbers must be finite."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.problems import Problem
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.camera.camera_models import named_model
from jaxbundle.camera.collinearity import photo_vector
from jaxbundle.camera.model import CameraModel
from jaxbundle.numerics.compilation import QUICKLY

TRIED = 16  # maximum number of rays per camera: a wrong model is wrong for most of them


def unusable_models(block: Block) -> list[Problem]:
    """Problems of camera models of the user that do not give finite numbers for the first rays."""
    s = block.structure
    own = [k for k, camera in enumerate(s.cameras) if named_model(camera.model) is None]
    if not own:
        return []
    unknowns, found = unknowns_of(block), []
    rotation, centre, points = (np.asarray(x) for x in (unknowns.rotation, unknowns.centre, unknowns.points))
    for k in own:
        rays = s.rays_of_camera[k][:TRIED]
        if len(rays) == 0:
            continue
        image, model = s.ray_image[rays], s.cameras[k].model
        vector: Any = photo_vector(
            tuple(rotation[:, image]), tuple(centre[:, image]), tuple(points[:, s.ray_point[rays]])
        )
        elements = np.asarray(block.interior.elements)[k, : len(model.elements)]
        measured = np.asarray(block.rays.coordinates)[rays].T
        numbers = np.concatenate([np.broadcast_to(elements[:, None], (len(elements), len(rays))), vector, measured])
        residuals, derivatives = (np.asarray(x) for x in _linearised(model, numbers))
        in_front = np.isfinite(numbers).all(0) & (numbers[len(elements) + 2] != 0)
        for what, values in (("residual", residuals), ("derivative of the residual", derivatives)):
            wrong = np.flatnonzero(in_front & ~np.isfinite(values).all(tuple(range(values.ndim - 1))))
            if len(wrong):
                found.append(_no_number(block, k, what, int(rays[wrong[0]]), f"{len(wrong)} of {len(rays)}"))
                break
    return found


def _linearised(
    model: CameraModel, numbers: Float[np.ndarray, "number ray"]
) -> tuple[Float[Array, "component ray"], Float[Array, "component number ray"]]:
    """Residuals and their derivatives with respect to interior, photo vector and measured coordinates."""
    padded = np.resize(numbers.T, (TRIED, len(numbers))).T  # one shape for all cameras of a model
    return jax.tree.map(lambda x: x[..., : numbers.shape[1]], _program(model)(padded))


@cache
def _program(model: CameraModel) -> Callable[[Any], Any]:
    """Residual and derivatives of a model for many rays, compiled once for each model."""
    n = len(model.elements)

    def residual(x: Float[Array, " number"]) -> Float[Array, " component"]:
        return jnp.stack(model.residual(tuple(x[:n]), (x[n], x[n + 1], x[n + 2]), tuple(x[n + 3 :])))

    both = jax.vmap(lambda x: (residual(x), jax.jacfwd(residual)(x)), 1, -1)
    return jax.jit(both, compiler_options=QUICKLY)


def _no_number(block: Block, camera: int, what: str, ray: int, share: str) -> Problem:
    s = block.structure
    return Problem(
        f"the camera model {s.cameras[camera].model.name!r} of camera {s.cameras[camera].name}: the {what} is not a"
        f" finite number for point {s.point_names[s.ray_point[ray]]} on image {s.image_names[s.ray_image[ray]]}"
        f" ({share} rays tried)",
        "guard roots, logarithms and divisions in the model, or correct the interior elements and approximate values",
        "rays",
        ray,
    )
