"""Standard deviations by propagation from the image coordinates, including errors that the weights neglect.

A ray in the common image of two models has the same error in both, and all points of a model share the errors of
its relative orientation. The weights neglect that, so N^-1 is too small. With the errors of all observations, in units
of their weights, as functions dv = M u of independent errors u of the image coordinates and of other observations,

    x - x_true = -N^-1 A^T dv,    Q = N^-1 A^T M M^T A N^-1,    sigma0^2 = v^T P v / tr((I - A N^-1 A^T) M M^T)

(law of propagation of variances; sigma0 by the expectation of v^T P v). It needs the full design matrix.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.design import MAX_UNKNOWNS
from jaxbundle.independent.formation import Models
from jaxbundle.independent.joined import element_errors, point_errors
from jaxbundle.independent.sensors import lower_triangles
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.statistics.dense import UnknownTables, dense_system


class Propagated(NamedTuple):
    """A-posteriori precision by propagation."""

    sigma0: float
    """Standard deviation of unit weight of the image coordinates, without the bias of the method's weights."""
    standard_deviations: UnknownTables
    """Standard deviations of the unknowns; angles of the sensors in radians; NaN for fixed ones."""
    ratio: float
    """Root mean square ratio of the standard deviations of object coordinates to those from N^-1."""


def propagated(adjustment: Adjustment, errors: sp.csr_matrix) -> Propagated | None:
    """The precision of an adjustment whose observations have the errors M, one row per residual: see `all_errors`.

    None for a block with too many unknowns for a dense design matrix, or without standard deviations.
    """
    structure = adjustment.block.structure
    if structure.n_unknowns > MAX_UNKNOWNS or adjustment.cofactors is None or adjustment.undetermined:
        return None
    system = dense_system(adjustment)
    if adjustment.reweighting is not None:  # the system has the weights of the last round
        roots = np.ones(len(errors.indptr) - 1)
        of_rays = np.repeat(np.sqrt(np.asarray(adjustment.reweighting.weights)), structure.model.components)
        roots[: len(of_rays)] = of_rays
        errors = sp.csr_matrix(sp.diags(roots) @ errors)
    covariance = sp.csr_matrix(errors @ errors.T)
    explained = system.orthogonal.T @ (covariance @ system.orthogonal)
    expected = float(covariance.diagonal().sum() - np.trace(explained))
    sigma0 = float(np.sqrt(float(adjustment.vtpv) / expected)) if expected > 0 else np.nan
    variances = np.einsum("uf,uf->u", system.inverse @ explained, system.inverse)
    tables = system.unknown_tables(sigma0 * np.sqrt(np.maximum(variances, 0.0)))
    before = np.asarray(adjustment.standard_deviations.object_points)
    free = structure.point_free & (before > 0)
    ratio = float(np.sqrt(np.mean((tables.object_points[free] / before[free]) ** 2))) if free.any() else np.nan
    return Propagated(sigma0, tables, ratio)


def all_errors(block: Block, of_rays: sp.csr_matrix, of_priors: sp.csr_matrix | None = None) -> sp.csr_matrix:
    """The matrix M of all observations: given for the rays, and for the last group if given; others independent."""
    masks = [group.structure.observed.ravel() for group in block.groups]
    independent = np.concatenate([np.zeros(0, bool), *(masks if of_priors is None else masks[:-1])])
    others = sp.identity(len(independent), format="csr").multiply(independent[:, None])
    columns = sp.csr_matrix(others)[:, independent]
    rays = of_rays if of_priors is None else sp.csr_matrix(sp.vstack([of_rays, of_priors]))
    both = sp.csr_matrix(sp.block_diag([rays, columns]))
    seen, end, count = (len(matrix.indptr) - 1 for matrix in (of_rays, rays, both))
    return sp.csr_matrix(both[np.concatenate([np.arange(seen), np.arange(end, count), np.arange(seen, end)])])


def model_errors(models: Models, block: Block, rays: int, estimate_shared: bool) -> sp.csr_matrix:
    """The matrix M of the block of models, with respect to the errors of `rays` rays of photographs."""
    factor = lower_triangles(np.asarray(block.rays.coordinates)[:, 3:9])
    parts, priors, at = [], [], 0
    for m in range(len(models)):
        used = np.flatnonzero(models.used[m])
        e = element_errors(models, m, rays)
        points = point_errors(models, m, used, rays)
        base = sp.csr_matrix(models.shared_base[m]) @ e
        if estimate_shared:
            points, base = points - sp.csr_matrix(models.shared[m, used].reshape(-1, 5)) @ e, 0 * base
        whole = sp.vstack([points, sp.csr_matrix((3, 2 * rays)), base])
        parts.append(-whitening(factor[at : at + len(used) + 2]) @ whole)
        # the unknown is the correction, minus the error; the scale has no prior
        priors.append(sp.vstack([sp.csr_matrix((1, 2 * rays)), -e]))
        at += len(used) + 2
    of_rays, of_priors = sp.csr_matrix(sp.vstack(parts)), sp.csr_matrix(sp.vstack(priors))
    return all_errors(block, of_rays, of_priors if estimate_shared else None)


def whitening(factor: Float[np.ndarray, "ray 3 3"]) -> sp.csr_matrix:
    """The factors L^-1 as one block-diagonal matrix."""
    count = len(factor)
    return sp.csr_matrix(sp.bsr_matrix((factor, np.arange(count), np.arange(count + 1)), (3 * count, 3 * count)))
