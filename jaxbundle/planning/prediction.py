"""The precision of a planned block: one linearisation at the planned values, no noise and no solve.

    Q = (A^T P A)^-1,        sigma = sqrt(diag Q)        standard deviation of unit weight 1: the sigmas of the block

The observations are replaced by values without residuals at the values of the block, so that a camera model that
corrects the measurement is linearised at the correct position. The result is equal to the cofactors of an adjustment
with these values.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbundle.block.block import Block
from jaxbundle.block.consistency import require_consistent
from jaxbundle.block.datum import with_datum
from jaxbundle.block.findings import Finding
from jaxbundle.block.given import require_a
from jaxbundle.block.unknowns import known_centres, unknowns_of
from jaxbundle.block.validate import require_valid
from jaxbundle.normals.from_block import problem, to_elimination_order
from jaxbundle.normals.plan.known_plans import planned
from jaxbundle.numerics.compilation import RAYS_FOR_OPTIMISATION
from jaxbundle.numerics.host import constant, on_device, on_host
from jaxbundle.planning.exact import traced_coordinates
from jaxbundle.planning.navigation_errors import consistent_groups
from jaxbundle.solve.adjust import devices_of
from jaxbundle.solve.adjustment import Adjustment, BlockCofactors, Iterations, StandardDeviations, Status
from jaxbundle.solve.answer import Ended, adjustment
from jaxbundle.solve.free_network import freed
from jaxbundle.solve.history import empty_history
from jaxbundle.solve.options import Options
from jaxbundle.statistics.reliability_tables import LEVEL, POWER, Reliability, reliability


class Prediction(eqx.Module):
    """The predicted precision of a block. It is a pytree, so it works with jit, grad and vmap.

    `linearised` is the block with its exact observations as an adjustment without iterations, for functions of
    an adjustment that need neither residuals nor sigma0, such as `jb.statistics.reliability`.

    Example:
        >>> prediction.standard_deviations.object_points.shape == flight.truth.object_points.shape
        True
    """

    linearised: Adjustment

    @property
    def block(self) -> Block:
        """The planned block with observations without residuals."""
        return self.linearised.block

    @property
    def cofactors(self) -> BlockCofactors:
        """Blocks of Q: covariances for the given sigmas."""
        assert self.linearised.cofactors is not None
        return self.linearised.cofactors

    @property
    def standard_deviations(self) -> StandardDeviations:
        """A-priori standard deviations of all unknowns: object unit, radians, unit of interior elements; 0 if fixed."""
        return self.cofactors.standard_deviations(1.0)

    @property
    def interior_correlations(self) -> Float[Array, "camera element element"]:
        """Correlations of the interior elements of each camera."""
        return self.cofactors.interior_correlations

    @property
    def redundancy_numbers(self) -> tuple[Array, ...]:
        """Redundancy numbers, one table for the rays and one for each group."""
        assert self.linearised.redundancy_numbers is not None
        return self.linearised.redundancy_numbers

    @property
    def undetermined(self) -> tuple[Finding, ...]:
        """Findings about undetermined unknowns; the precision is meaningless until they are solved."""
        return self.linearised.undetermined

    def reliability(self, level: float = LEVEL, power: float = POWER) -> Reliability:
        """Predicted reliability: minimal detectable errors and their maximum effects (Baarda 1968)."""
        return reliability(self.linearised, level, power)


def predict(block: Block) -> Prediction:
    """Predicts the precision of a block from its geometry and its sigmas, before anything is measured.

    Args:
        block: the planned block at its expected values, such as the truth of a simulation. Its sigmas are used, its
            measured values are not.

    Returns: the prediction; it is differentiable with respect to all values of the block: positions, angles, sigmas,
    interior elements.

    Raises: TypeError for an object that is not a Block; BlockError with all problems of the block; ValueError without
        float64.

    Example:
        >>> prediction = jb.planning.predict(flight.truth)
        >>> bool((prediction.standard_deviations.object_points >= 0).all())
        True
    """
    require_a(Block, block, "planning.predict")
    options = Options()  # raises an error without float64
    require_consistent(constant(block))
    differentiable = not block.concrete
    if not differentiable:
        block = with_exact_observations(block)
        require_valid(block)
    values = with_datum(constant(block))
    block = dataclasses.replace(block, structure=values.structure)
    if differentiable:
        if block.structure.datum.kind == "inner":
            raise ValueError("a free network cannot be predicted inside jit, grad and vmap; use a minimal datum there")
        block = with_exact_observations(block)
    origin = on_host(constant(block).exterior.projection_centre).mean(0)
    centred = block.moved(-origin)
    centres = known_centres(values)
    devices = 1 if centres is None else devices_of(values, None)
    plan = planned(block.structure, block.groups, centres, devices)
    given, arranged = problem(plan, centred), to_elimination_order(plan, unknowns_of(centred))
    if block.structure.datum.kind == "inner":
        block = dataclasses.replace(block, structure=freed(block.structure))
    optimised = len(block.structure.ray_image) >= RAYS_FOR_OPTIMISATION
    zero = jnp.zeros(())
    iterations = Iterations(
        on_device(int(Status.CONVERGED)), on_device(0), on_device(0), zero, zero, zero, zero, empty_history(0)
    )
    ended = Ended(iterations, origin, options, True, True, differentiable, optimised)
    return Prediction(adjustment(block, plan, given, arranged, ended))


def with_exact_observations(block: Block) -> Block:
    """The block with observations without residuals at its values; works with jit, grad and vmap."""
    coordinates = traced_coordinates(block) if block.structure.model.photographs else block.rays.coordinates
    return eqx.tree_at(lambda b: (b.rays.coordinates, b.groups), block, (coordinates, consistent_groups(block)))
