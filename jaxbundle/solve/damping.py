"""Damping: acceptance of a trial step, and the damping of the next one.

(N + lambda D) d = -g,   D = diag(N)                     Marquardt's scaling: free of units

rho = (reduction of v^T P v / 2) / (predicted reduction)
accepted   lambda <- lambda max(1/10, 1 - (2 rho - 1)^3), growth <- 2
rejected   lambda <- growth lambda, growth <- 2 growth    Nielsen (1999); Madsen, Nielsen, Tingleff (2004), sec. 3.2

Nielsen's minimum factor is 1/3; 1/10 is from Marquardt (1963), and saves a sixth of the steps of an aerial block.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxbundle.numerics.host import on_device

INITIAL_DAMPING = 1e-4  # Ceres's first trust region; with 1e-6 Ladybug-49 converges to a worse minimum
MIN_FACTOR = 0.1
MIN_RATIO = 1e-3  # minimum share of the predicted reduction for an accepted step; Ceres's min_relative_decrease


class DampingState(NamedTuple):
    """State of the damping. `factor` is lambda; `raised`: whether lambda was raised since the last accepted step."""

    factor: Float[Array, ""]
    growth: Float[Array, ""]
    raised: Bool[Array, ""]


class AbstractDamping(eqx.Module):
    """Base class: decides on a trial step and on the damping of the next one.

    This is not the protocol of `optimistix.AbstractSearch`, which scales the step of a descent that is computed once:
    here the normal equations are solved again for each damping.
    """

    @abc.abstractmethod
    def initial_state(self) -> DampingState:
        """The state of the first step; called once per solve."""

    @abc.abstractmethod
    def judge_step(
        self, state: DampingState, reduction: Array, predicted: Array, cost: Array, noise: Array
    ) -> tuple[Bool[Array, ""], DampingState]:
        """Whether the trial is accepted, and the state of the next step; called after each trial.

        All numbers belong to v^T P v / 2; `noise` is that of rounding errors of the residuals.
        """


class Marquardt(AbstractDamping):
    """Levenberg-Marquardt with the control of lambda of Nielsen (1999)."""

    initial_damping: float = INITIAL_DAMPING

    def initial_state(self) -> DampingState:
        return DampingState(*on_device((self.initial_damping, 2.0, False)))

    def judge_step(
        self, state: DampingState, reduction: Array, predicted: Array, cost: Array, noise: Array
    ) -> tuple[Bool[Array, ""], DampingState]:
        ratio = reduction / predicted
        floor = 16 * jnp.finfo(cost.dtype).eps * cost + 2 * jnp.sqrt(cost * noise) + noise
        # at the rounding level the ratio is noise: a full step is accepted, damped ones would never end
        at_floor = (jnp.abs(reduction) <= floor) & (jnp.abs(predicted) <= floor) & ~state.raised
        accepted = (jnp.isfinite(reduction) & (predicted > 0) & (ratio > MIN_RATIO)) | at_floor
        factor = jnp.maximum(MIN_FACTOR, 1 - (2 * jnp.where(at_floor, 1.0, ratio) - 1) ** 3)
        raised = state.factor * jnp.where(accepted, factor, state.growth)
        return accepted, DampingState(raised, jnp.where(accepted, 2.0, 2 * state.growth), ~accepted)


class Undamped(AbstractDamping):
    """Gauss-Newton: lambda is 0, and all steps are full steps."""

    def initial_state(self) -> DampingState:
        return DampingState(*on_device((0.0, 1.0, False)))

    def judge_step(
        self, state: DampingState, reduction: Array, predicted: Array, cost: Array, noise: Array
    ) -> tuple[Bool[Array, ""], DampingState]:
        return jnp.isfinite(reduction), state
