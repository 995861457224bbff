"""Weight functions of robust estimation, and a block with these weights.

    Huber (1964)                w = 1 for t <= k, k / t above
    Cauchy                      w = 1 / (1 + (t / k)^2)
    Tukey's biweight (1974)     w = (1 - (t / k)^2)^2 for t <= k, 0 above
    Danish method               w = 1 for t <= k, exp(1 - (t / k)^2) above       after Krarup, Juhl & Kubik (1980)

t is the length of a ray's residual over its sigmas and over the common scale. The last three give large residuals
no influence and have many minima.
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.numerics.host import tree_with

MIN_WEIGHT = 1e-12  # weight of a down-weighted ray instead of 0: its sigma is then finite


class AbstractWeightFunction(eqx.Module):
    """Base class: a weight as a function of the standardised length of a ray's residual; `limit` is k."""

    name: ClassVar[str]
    limit: eqx.AbstractVar[float]
    redescending: ClassVar[bool] = True  # large residuals have no influence

    @abc.abstractmethod
    def weights(self, t: Float[Array, " ray"]) -> Float[Array, " ray"]:
        """Weights between 0 and 1 for standardised lengths."""


class Huber(AbstractWeightFunction):
    """Huber's weights; 5 % of errors that are normal in both coordinates exceed the limit.

    Example:
        >>> jb.adjust(block, robust=jb.robust.Huber()).success
        True
    """

    name: ClassVar[str] = "huber"
    limit: float = eqx.field(static=True, converter=float, default=2.45)
    redescending: ClassVar[bool] = False

    def weights(self, t: Float[Array, " ray"]) -> Float[Array, " ray"]:
        return jnp.minimum(1.0, self.limit / jnp.maximum(t, self.limit))


class Cauchy(AbstractWeightFunction):
    """Cauchy's weights; 95 % efficient for normal errors of one coordinate at 2.385 (Holland & Welsch 1977).

    Example:
        >>> jb.robust.Cauchy().limit
        2.385
    """

    name: ClassVar[str] = "cauchy"
    limit: float = eqx.field(static=True, converter=float, default=2.385)

    def weights(self, t: Float[Array, " ray"]) -> Float[Array, " ray"]:
        return 1 / (1 + (t / self.limit) ** 2)


class Tukey(AbstractWeightFunction):
    """Tukey's biweight; 95 % efficient for normal errors of one coordinate at 4.685 (Holland & Welsch 1977).

    Example:
        >>> jb.robust.Tukey().limit
        6.0
    """

    name: ClassVar[str] = "tukey"
    limit: float = eqx.field(static=True, converter=float, default=6.0)

    def weights(self, t: Float[Array, " ray"]) -> Float[Array, " ray"]:
        return jnp.maximum(0.0, 1 - (t / self.limit) ** 2) ** 2


class Danish(AbstractWeightFunction):
    """Weights of the Danish method; unchanged below the limit, which one normal error in ninety exceeds.

    Example:
        >>> jb.robust.Danish(limit=2.5).limit
        2.5
    """

    name: ClassVar[str] = "danish"
    limit: float = eqx.field(static=True, converter=float, default=3.0)

    def weights(self, t: Float[Array, " ray"]) -> Float[Array, " ray"]:
        return jnp.exp(jnp.minimum(0.0, 1 - (t / self.limit) ** 2))


WEIGHT_FUNCTIONS = {function.name: function for function in (Huber, Cauchy, Tukey, Danish)}


def with_weights(block: Block, sigmas: Float[np.ndarray, "ray 2"], weights: Float[np.ndarray, " ray"]) -> Block:
    """The block in which the sigmas of the rays are `sigmas` divided by the roots of the weights."""
    factor = np.sqrt(np.maximum(weights, MIN_WEIGHT))[:, None]
    return tree_with(lambda b: b.rays.sigmas, block, sigmas / factor)
