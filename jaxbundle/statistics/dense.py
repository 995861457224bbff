"""The dense design matrix of an adjustment, for functions that need the full N^-1, up to some thousands of unknowns.

A = U R          A: derivatives by autodiff of the weighted residuals with respect to free unknowns; U^T U = I
N^-1 = (A^T A)^-1 = R^-1 R^-T              cofactors of the unknowns
A N^-1 A^T = U U^T,   r = 1 - diag(U U^T)  redundancy numbers of the observations
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.design import MAX_UNKNOWNS, design_columns, elements, free_elements
from jaxbundle.block.residuals import Observations, observations_of
from jaxbundle.block.unknowns import Unknowns, angle_derivatives, unknowns_of
from jaxbundle.normals.cholesky import inverse_factor
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.subsets import Subset

UNKNOWNS_FOR_OPTIMISATION = 500  # below this, the design matrix takes less time than optimising its program
MIN_PIVOT = 1e-11  # of a column of A: below this rounding decides, as in the search for undetermined unknowns


class UnknownTables(NamedTuple):
    """One number for each unknown, in the tables of the block; NaN for fixed elements. Angles are the user's."""

    exterior: Float[np.ndarray, "image 6"]
    interior: Float[np.ndarray, "camera element"]
    parameters: Float[np.ndarray, " parameter"]
    object_points: Float[np.ndarray, "point 3"]


class DenseSystem(NamedTuple):
    """The matrices U and R^-1 (for attitudes in the user's angles); observations follow `tables`, row by row."""

    structure: Structure
    observed: tuple[Bool[np.ndarray, "_member _component"], ...]
    orthogonal: Float[np.ndarray, "observation free"]
    inverse: Float[np.ndarray, "free free"]

    def rows(self, subset: Subset) -> Int[np.ndarray, " chosen"]:
        """The rows of the observations of a subset."""
        return np.flatnonzero(np.concatenate([mask.ravel() for mask in subset.masks]))

    def tables(self, numbers: Float[np.ndarray, " observation"]) -> tuple[Float[np.ndarray, "_member _component"], ...]:
        """One number for each observation, in tables like the residuals; 0 where not observed."""
        ends = np.cumsum([mask.size for mask in self.observed])
        parts = np.split(numbers, ends[:-1])
        return tuple(
            np.where(mask, part.reshape(mask.shape), 0.0) for part, mask in zip(parts, self.observed, strict=True)
        )

    def unknown_tables(self, numbers: Float[np.ndarray, " free"]) -> UnknownTables:
        """One number for each free unknown, in tables."""
        tables, first = [], 0
        structure, elements = self.structure, self.structure.interior_free
        for mask in (structure.exterior_free.T, elements.T, structure.parameter_free, structure.point_free.T):
            table = np.full(mask.shape, np.nan)
            table[mask] = numbers[first : first + mask.sum()]
            first += int(mask.sum())
            tables.append(table.T)
        return UnknownTables(*tables)

    @property
    def unknown_names(self) -> tuple[str, ...]:
        """Names of the free unknowns for the user, in their order."""
        s = self.structure
        names = [f"{e} of image {i}" for e, i in _free(s.exterior_elements, s.image_names, s.exterior_free)]
        for k in s.interior_columns:
            cameras = [camera for camera, free in zip(s.cameras, s.interior_free[:, k], strict=True) if free]
            names += [f"{camera.model.elements[k]} of camera {camera.name}" for camera in cameras]
        names += [parameter.name for parameter in s.parameters if parameter.free]
        return (*names, *(f"{c} of point {p}" for c, p in _free("XYZ", s.point_names, s.point_free)))


def _free(
    elements: Sequence[str], names: Sequence[str], free: Bool[np.ndarray, "entity element"]
) -> list[tuple[str, str]]:
    """Each free element with the name of its entity."""
    return [(elements[int(k)], names[int(row)]) for k, row in np.argwhere(free.T)]


def dense_system(adjustment: Adjustment) -> DenseSystem:
    """The system at the adjusted unknowns, with the final weights of the adjustment.

    Raises: ValueError for a large block, and for undetermined unknowns.
    """
    return block_system(adjustment.weighted_block)


def block_system(block: Block) -> DenseSystem:
    """The system at the values of a block with a defined datum; raises as `dense_system`."""
    structure = block.structure
    if structure.n_unknowns > MAX_UNKNOWNS:
        raise ValueError(
            f"this requires the full cofactor matrix, limited to {MAX_UNKNOWNS} unknowns; the block has"
            f" {structure.n_unknowns}"
        )
    centred = block.moved(-np.asarray(block.exterior.projection_centre).mean(0))
    observations = observations_of(centred)
    free = free_elements(observations)
    orthogonal, inverse, pivots, turned = _factors(
        unknowns_of(centred),
        observations,
        free.chunks.astype(np.int32),
        block.exterior.angles,
        optimised=free.number >= UNKNOWNS_FOR_OPTIMISATION,
    )
    if not np.all(np.asarray(pivots)[: free.number] > MIN_PIVOT):
        raise ValueError("some unknowns are undetermined; the findings of adjust() name them")
    orthogonal, inverse = np.array(orthogonal[:, : free.number]), np.array(inverse[: free.number, : free.number])
    exterior = np.zeros((6, len(structure.image_names), free.number))
    exterior[structure.exterior_free.T] = inverse[: structure.exterior_free.sum()]
    exterior[3:] = np.einsum("abi,bif->aif", np.asarray(turned), exterior[3:])
    inverse[: structure.exterior_free.sum()] = exterior[structure.exterior_free.T]
    everything = (
        np.ones((len(structure.ray_image), structure.model.components), bool),
        *(g.structure.observed for g in block.groups),
    )
    return DenseSystem(structure, everything, orthogonal, inverse)


def redundancy_numbers(adjustment: Adjustment) -> tuple[Float[np.ndarray, "_member _component"], ...]:
    """Redundancy numbers r of all observations, in tables like the residuals; 0 where not observed; their sum is M - N.

    For correlated components of a member they refer to uncorrelated combinations: only their sum is meaningful.

    Raises: ValueError for a large block, and for undetermined unknowns.
    """
    system = dense_system(adjustment)
    return system.tables(1 - np.sum(system.orthogonal**2, 1))


@Compiled
def _factors(
    unknowns: Unknowns, o: Observations, free: Int[Array, "chunk at_once"], reference: Float[Array, "image 3"]
) -> tuple[Array, Array, Array, Float[Array, "3 3 image"]]:
    """U, R^-1, pivots of N with a unit diagonal, derivatives of the user's angles by small angles; zero-padded.

    By two Cholesky factorisations, N = A^T A and then U^T U (CholeskyQR2, Yamamoto et al. 2015): as accurate as
    Householder's method if N has a factor, and without LAPACK's threads.
    """
    columns = design_columns(unknowns, o, free)
    lengths = jnp.linalg.norm(columns, axis=1)
    scale = jnp.where(lengths > 0, 1 / jnp.where(lengths > 0, lengths, 1.0), 0.0)
    missing = free.ravel() >= elements(o)
    design = (columns * scale[:, None]).T
    first = inverse_factor(design.T @ design + jnp.diag(missing.astype(float)))
    nearly = design @ first.T
    second = inverse_factor(nearly.T @ nearly + jnp.diag(missing.astype(float)))
    turned = angle_derivatives(unknowns.rotation, o.in_angles, reference.T, o.system)
    inverse = scale[:, None] * (second @ first).T
    return nearly @ second.T, inverse, 1 / jnp.diagonal(first) ** 2, turned
