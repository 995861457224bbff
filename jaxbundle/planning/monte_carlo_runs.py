"""Monte Carlo test of a prediction: many complete adjustments of one block, each with other errors.

    q = sum over draws of (x - x_true)^2 / sigma^2       chi-square distributed with one degree of freedom per draw

Sigma is the predicted one. Single coordinates are tested at a level; the mean of q / draws over all points, which are
correlated, has a scatter that is estimated from the draws.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtri

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.given import require_a
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.numerics.compilation import QUICKLY, RAYS_FOR_OPTIMISATION
from jaxbundle.planning.prediction import Prediction, predict
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.status import Status

LEVEL = 0.001  # level of the two-sided test of one coordinate
DEVIATIONS = 4.0  # limit of the mean over all coordinates in its standard deviations


class MonteCarlo(NamedTuple):
    """Comparison of the scatter of many adjustments about the truth with the prediction.

    Example:
        >>> runs = jb.planning.monte_carlo(flight.truth, 20)
        >>> runs.draws, runs.converged
        (20, 20)
    """

    draws: int
    converged: int
    """Number of converged adjustments; the others are left out."""
    ratios: Float[np.ndarray, "point 3"]
    """Mean of (x - x_true)^2 / sigma^2, NaN for fixed coordinates; 1 if scatter and prediction agree."""
    bias: Float[np.ndarray, "point 3"]
    """Mean of x - x_true in standard deviations of this mean."""
    sigma0: float
    """Root of the mean of sigma0^2; 1 if the sigmas are those of the errors."""
    limits: tuple[float, float]
    """Limits of a single ratio at the level of the test."""
    mean: float
    """Mean of the ratios."""
    mean_sigma: float
    """Standard deviation of the mean, from the draws."""
    prediction: Prediction

    @property
    def share_outside(self) -> float:
        """Share of the coordinates outside the limits; 0.001 are expected by chance."""
        single = self.ratios[np.isfinite(self.ratios)]
        return float(np.mean((single < self.limits[0]) | (single > self.limits[1])))

    @property
    def passed(self) -> bool:
        """Whether the mean agrees with 1 within four of its standard deviations and few coordinates are outside."""
        return abs(self.mean - 1) < DEVIATIONS * self.mean_sigma and self.share_outside < 0.02


def monte_carlo(block: Block, draws: int = 500, seed: int = 0) -> MonteCarlo:
    """Adjusts a block `draws` times with new errors, all in one call, and compares the scatter with the prediction.

    Args:
        block: the planned block at its true values, such as the truth of a simulation.
        draws: number of adjustments.
        seed: seed of the errors.

    Raises: TypeError for an object that is not a Block; ValueError for fewer than 20 draws.

    Example:
        >>> runs = jb.planning.monte_carlo(flight.truth, 20)
        >>> runs.ratios.shape == flight.truth.object_points.shape
        True
    """
    require_a(Block, block, "planning.monte_carlo")
    if draws < 20:
        raise ValueError(f"{draws} draws are too few; give at least 20")
    prediction = predict(block)
    truth = with_datum(prediction.block)
    sigmas = np.asarray(prediction.standard_deviations.object_points)

    options = QUICKLY if len(block.structure.ray_image) < RAYS_FOR_OPTIMISATION else {}

    @partial(jax.jit, compiler_options=options)
    def all_draws(keys: Array) -> tuple[Array, Array, Array]:
        def one(key: Array) -> tuple[Array, Array, Array]:
            adjusted = adjust(drawn(truth, key), precision=False)
            return adjusted.block.object_points - truth.object_points, adjusted.sigma0, adjusted.iterations.status

        return jax.lax.map(one, keys)

    errors, sigma0, status = (np.asarray(x) for x in all_draws(jax.random.split(jax.random.key(seed), draws)))
    used = status == int(Status.CONVERGED)
    free = sigmas > 0
    reduced = np.where(free, errors[used] / np.where(free, sigmas, 1.0), np.nan)
    ratios, count = (reduced**2).mean(0), int(used.sum())
    by_draw = np.nanmean(reduced**2, axis=(1, 2))
    bias = reduced.mean(0) * np.sqrt(count)
    low, high = (float(chdtri(count, p)) / count for p in (1 - LEVEL / 2, LEVEL / 2))
    mean_sigma = float(by_draw.std(ddof=1) / np.sqrt(count))
    root = float(np.sqrt((sigma0[used] ** 2).mean()))
    return MonteCarlo(draws, count, ratios, bias, root, (low, high), float(by_draw.mean()), mean_sigma, prediction)


def drawn(block: Block, key: Array) -> Block:
    """The block with new normal errors of all observations; works with jit, grad and vmap."""
    keys = jax.random.split(key, 1 + len(block.groups))
    rays = block.rays.coordinates + block.rays.sigmas * jax.random.normal(keys[0], block.rays.sigmas.shape)

    def errors(group: ObservationGroup, key: Array) -> Float[Array, "member component"]:
        normal = jax.random.normal(key, group.sigmas.shape)
        if group.covariances is None:
            return group.sigmas * normal
        both = group.structure.observed[:, :, None] & group.structure.observed[:, None, :]
        factor = jnp.linalg.cholesky(jnp.where(both, group.covariances, jnp.eye(both.shape[1])))
        return jnp.einsum("mij,mj->mi", factor, normal)

    groups = tuple(
        eqx.tree_at(lambda g: g.values, g, g.values + errors(g, k)) for g, k in zip(block.groups, keys[1:], strict=True)
    )
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), block, (rays, groups))
