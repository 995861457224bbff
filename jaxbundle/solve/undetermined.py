"""Findings about undetermined points, parts of the block, and other unknowns.

Directions of the unknowns without an effect on the observations are searched for in three steps. Points: by the pivots
of their 3 x 3 equations. Similarity transformations of the whole block, or of a part of it: by

    c^T G^T S G c / c^T G^T D G c        G: such transformations of each part; S reduced equations, D = diag(N)

Other directions: by the eigenvectors of S, scaled to the unit diagonal of N. The first and the last step depend
on the values of the unknowns, so they are reported only at a minimum; a similarity transformation never changes the
rays.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from jaxbundle.block.block import Block, Structure
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.parts import parts_of
from jaxbundle.block.wording import named
from jaxbundle.normals.inspection import WEAKEST_SHARE, Inspection, reduced_products
from jaxbundle.normals.plan.elimination_plan import EliminationPlan
from jaxbundle.normals.problem import NormalVector, OrderedUnknowns, Problem, ReducedVector
from jaxbundle.normals.reduced_system import ReducedSystem
from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, on_host
from jaxbundle.numerics.shapes import grid_size
from jaxbundle.solve.free_network import similarities
from jaxbundle.solve.similarity_findings import Gauge, gauge_findings

MAX_NAMED = 3000  # unknowns of the reduced equations; above this only the failed one is reported
HELD = 1e-8  # share of a transformation's length that changes a fixed unknown
RANK = 1e-10  # share of the maximum: smaller ones are combinations of others, such as the scale of a single image
TOGETHER = 1e-3  # element of the projector on the null space: below this two unknowns are independent
TAKES_PART = 0.3  # share of the maximum in a direction: larger unknowns are named
CURES = {
    "image": "measure more and better spread points on the image, or add control",
    "camera": "fix the element, add control in relief, or add convergent and rotated images",
    "parameter": "fix it, give it a prior value with a sigma, or add observations that depend on it",
    "point": "measure the point on one more image from a different position, give it coordinates or drop it",
}


class Undetermined(NamedTuple):
    """The findings, and the number of undetermined directions."""

    findings: tuple[Finding, ...] = ()
    directions: int = 0


class End(NamedTuple):
    """The end of an adjustment: the adjusted block; plan, observations and unknowns relative to `origin`."""

    block: Block
    plan: EliminationPlan
    problem: Problem
    arranged: OrderedUnknowns
    origin: Float[np.ndarray, "3"]


class Scaled(NamedTuple):
    """The reduced equations on the host; `root`: square roots of the diagonal of N, 0 for fixed unknowns."""

    system: ReducedSystem
    pair: Int[np.ndarray, "pair 2"]
    root: Float[np.ndarray, " kept"]
    end: End

    def product(self, x: Float[np.ndarray, "kept k"]) -> Float[np.ndarray, "kept k"]:
        """The product S x."""
        if self.end.plan.layout.implicit:
            return self._by_passes(x)
        system, (images, d) = self.system, self.system.diagonal.shape
        used = self.pair[:, 0] < images
        (i, j), blocks = self.pair[used].T, np.asarray(system.pairs)[used]
        at, border = x[: images * d].reshape(images, d, -1), x[images * d :]
        coupling = np.asarray(system.coupling)
        out = np.einsum("idb,bk->idk", coupling, border)
        np.add.at(out, i, np.einsum("pde,pek->pdk", blocks, at[j]))
        other = i != j
        np.add.at(out, j[other], np.einsum("ped,pek->pdk", blocks[other], at[i[other]]))
        of_border = np.einsum("idb,idk->bk", coupling, at) + np.asarray(system.border) @ border
        return np.concatenate([out.reshape(images * d, -1), of_border])

    def _by_passes(self, x: Float[np.ndarray, "kept k"]) -> Float[np.ndarray, "kept k"]:
        """Computes S x without forming S: one pass through the tiles for each column."""
        images, d = self.system.diagonal.shape
        padded = np.zeros((grid_size(x.shape[1]), len(x)))
        padded[: x.shape[1]] = x.T
        vectors = ReducedVector(*on_device((padded[:, : images * d].reshape(-1, images, d), padded[:, images * d :])))
        found = _reduced_products(self.end.arranged, self.end.problem, vectors, optimised=False)
        both = np.concatenate([on_host(found.images).reshape(len(padded), -1), on_host(found.border)], 1)
        return both[: x.shape[1]].T

    def matrix(self) -> Float[np.ndarray, "kept kept"]:
        """The matrix S scaled to the unit diagonal of N; fixed unknowns have a unit row."""
        scale = np.where(self.root > 0, 1 / np.where(self.root > 0, self.root, 1.0), 0.0)
        return scale[:, None] * self.product(np.diag(scale)) + np.diag(np.where(self.root > 0, 0.0, 1.0))


def undetermined(end: End, found: Inspection, converged: bool) -> Undetermined:
    """The undetermined unknowns of a concrete adjustment."""
    structure, plan = end.block.structure, end.plan
    loose, loose_directions = _loose_points(structure, plan, found)
    kept = np.concatenate([np.asarray(found.image_pivots).ravel(), np.asarray(found.border_pivots)])
    soft = found.softest is not None and not float(found.softest.share) > WEAKEST_SHARE
    if np.all(kept > WEAKEST_SHARE) and not soft:
        return Undetermined(loose, loose_directions) if converged else Undetermined()
    scaled = _scaled(found.system, end)
    finite = np.isfinite(np.asarray(found.system.pairs)[scaled.pair[:, 0] < scaled.system.diagonal.shape[0]]).all()
    gauge, findings, directions = np.zeros((len(scaled.root), 0)), [], 0
    if finite and np.isfinite(scaled.root).all():
        gauge, findings = _gauge(end, scaled, converged)
        directions = gauge.shape[1]
    if converged:
        others, count = _others(structure, plan, scaled, found, gauge)
        findings, directions = [*findings, *loose, *others], directions + loose_directions + count
    return Undetermined(tuple(findings), directions)


def _loose_points(structure: Structure, plan: EliminationPlan, found: Inspection) -> tuple[tuple[Finding, ...], int]:
    """One finding for all points that their rays do not determine."""
    shares = np.ones(plan.order.points)
    shares[: plan.tile_points] = on_host(found.point_pivots).ravel()
    names = [structure.point_names[p] for p in np.nonzero(~(shares[plan.order.point] > WEAKEST_SHARE))[0]]
    if not names:
        return (), 0
    what = f"the observations do not determine {'points' if len(names) > 1 else 'point'} {named(names)}"
    return (Finding(Kind.UNDETERMINED, what, CURES["point"], tuple(Subject("points", (n,)) for n in names)),), len(
        names
    )


def _scaled(system: ReducedSystem, end: End) -> Scaled:
    free = np.concatenate([np.asarray(system.free).ravel(), np.asarray(system.border_free)])
    diagonal = np.concatenate([np.asarray(system.diagonal).ravel(), np.asarray(system.border_diagonal)])
    return Scaled(system, end.plan.reduced.padded_pairs, np.sqrt(np.where(free & (diagonal > 0), diagonal, 0.0)), end)


@Compiled
def _reduced_products(arranged: OrderedUnknowns, p: Problem, vectors: ReducedVector) -> ReducedVector:
    return reduced_products(arranged, p, vectors)


@Compiled
def _similarities(arranged: OrderedUnknowns, p: Problem) -> NormalVector:
    return similarities(arranged, p, 7)


def _gauge(end: End, scaled: Scaled, converged: bool) -> tuple[Float[np.ndarray, "kept direction"], list[Finding]]:
    """Undetermined similarity transformations of the block and of its parts, orthonormal and scaled."""
    plan, parts = end.plan, parts_of(end.block.structure)
    if len(parts) == 1 and not converged:
        return np.zeros((len(scaled.root), 0)), []  # control was checked before the start
    g = _similarities(end.arranged, end.problem, optimised=False)
    of_images, of_border = np.asarray(g.images), np.asarray(g.border)
    whole = np.concatenate([of_images.reshape(7, -1), of_border], 1).T
    own = _null_combinations(scaled, whole, plan)
    radius = float(np.sqrt(np.mean(np.sum(np.asarray(end.arranged.images.centre) ** 2, 0))))
    if len(parts) == 1:
        gauge = Gauge(own[:7], (own[:7],), parts, end.origin, radius)
        return _orthonormal(scaled, whole, own, plan), gauge_findings(end.block, gauge)
    columns, d = [], plan.layout.image
    for part in parts:
        mask = np.zeros(len(whole))
        rows = d * plan.order.image[part.images][:, None] + np.arange(d)
        mask[rows] = 1.0
        places = plan.order.point[np.setdiff1d(part.points, part.common)]
        in_border = places[places >= plan.tile_points] - plan.tile_points
        at = len(whole) - of_border.shape[1] + plan.layout.point_rows(in_border)
        mask[at] = 1.0
        columns.append(whole * mask[:, None])
    both = np.concatenate(columns, 1)
    combined = _null_combinations(scaled, both, plan)
    if combined.shape[1] <= own.shape[1]:
        gauge = Gauge(own[:7], (own[:7],), parts[:1], end.origin, radius)
        return _orthonormal(scaled, whole, own, plan), gauge_findings(end.block, gauge)
    by_part = tuple(combined[7 * k : 7 * k + 7] for k in range(len(parts)))
    if end.block.structure.datum.kind in ("minimal", "inner"):
        by_part = tuple(
            c - by_part[0] for c in by_part
        )  # common transformations of the parts are the choice of the datum
    gauge = Gauge(own[:7], by_part, parts, end.origin, radius)
    return _orthonormal(scaled, both, combined, plan), gauge_findings(end.block, gauge)


def _with_own(candidates: Float[np.ndarray, "kept k"], plan: EliminationPlan) -> Float[np.ndarray, "kept m"]:
    """The candidates, and unit columns of unknowns that may follow them: parameters and border points."""
    first = plan.layout.image * plan.order.images + plan.layout.first_parameter
    extra = np.zeros((len(candidates), len(candidates) - first))
    extra[first + np.arange(extra.shape[1]), np.arange(extra.shape[1])] = 1.0
    return np.concatenate([candidates, extra], 1)


def _null_combinations(
    scaled: Scaled, candidates: Float[np.ndarray, "kept k"], plan: EliminationPlan
) -> Float[np.ndarray, "m direction"]:
    """Coefficients of the candidates, and of the unknowns that follow them, without an effect on the observations."""
    x = _with_own(candidates, plan)
    real = np.ones(len(x), bool)
    d, images = plan.layout.image, plan.order.images
    real[: d * images] = np.repeat(np.isin(np.arange(images), plan.order.image), d)
    free = scaled.root > 0
    lengths = np.linalg.norm(x * real[:, None], axis=0)
    basis = np.diag(1 / np.where(lengths > 0, lengths, 1.0))[:, lengths > 0]
    held = (x @ basis)[real & ~free]
    _, size, vt = np.linalg.svd(np.concatenate([held, np.zeros((held.shape[1],) * 2)]), full_matrices=False)
    basis = basis @ vt[size <= HELD].T
    left, size, vt = np.linalg.svd((x @ basis) * scaled.root[:, None], full_matrices=False)
    chosen = size > RANK * size.max(initial=0.0)
    left, basis = left[:, chosen], basis @ (vt[chosen].T / size[chosen])
    inverse = np.where(free, 1 / np.where(free, scaled.root, 1.0), 0.0)[:, None]
    energy = left.T @ (inverse * scaled.product(inverse * left))
    if not np.isfinite(energy).all():
        return basis[:, :0]
    values, vectors = np.linalg.eigh((energy + energy.T) / 2)
    return basis @ vectors[:, values <= WEAKEST_SHARE]


def _orthonormal(
    scaled: Scaled,
    candidates: Float[np.ndarray, "kept k"],
    null: Float[np.ndarray, "m direction"],
    plan: EliminationPlan,
) -> Float[np.ndarray, "kept direction"]:
    if not null.shape[1]:
        return np.zeros((len(candidates), 0))
    left, size, _ = np.linalg.svd((_with_own(candidates, plan) @ null) * scaled.root[:, None], full_matrices=False)
    return left[:, size > 1e-8 * size[0]]


def _others(
    structure: Structure, plan: EliminationPlan, scaled: Scaled, found: Inspection, gauge: Float[np.ndarray, "kept g"]
) -> tuple[list[Finding], int]:
    """Undetermined directions other than similarity transformations, by the affected unknowns."""
    names, count = reduced_names(structure, plan), len(scaled.root)
    if found.softest is not None:
        direction = found.softest.direction
        vector = scaled.root * np.concatenate([np.asarray(direction.images).ravel(), np.asarray(direction.border)])
        vectors = (vector / np.linalg.norm(vector))[:, None]
        if not float(found.softest.share) <= WEAKEST_SHARE:
            vectors = np.eye(count)[:, _failed(found)]
    elif count > MAX_NAMED:
        vectors = np.eye(count)[:, _failed(found)[:1]] if not gauge.shape[1] else np.zeros((count, 0))
    else:
        matrix = scaled.matrix()
        if not np.isfinite(matrix).all():
            return [], 0
        values, vectors = np.linalg.eigh(matrix)
        vectors = vectors[:, values <= WEAKEST_SHARE]
    rest = vectors - gauge @ (gauge.T @ vectors)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    left = left[:, size > 0.1]  # a null vector is in the span of the others or, up to rounding, orthogonal to it
    return _by_cause(left, names), left.shape[1]


def _failed(found: Inspection) -> Int[np.ndarray, " failed"]:
    pivots = np.concatenate([np.asarray(found.image_pivots).ravel(), np.asarray(found.border_pivots)])
    return np.flatnonzero(~(pivots > WEAKEST_SHARE))


def _by_cause(null: Float[np.ndarray, "kept direction"], names: dict[int, tuple[str, str, str]]) -> list[Finding]:
    """One finding for each set of unknowns that change together, independent of the basis of the null space."""
    moved = np.linalg.norm(null, axis=1)
    rows = np.array([k for k in np.flatnonzero(moved > TOGETHER) if k in names], int)
    if not len(rows):
        return []
    projector = np.abs(null[rows] @ null[rows].T) > TOGETHER
    count, label = connected_components(scipy.sparse.csr_matrix(projector), directed=False)
    found = []
    for cause in range(count):
        own = rows[label == cause]
        own = own[np.argsort(-moved[own], kind="stable")]
        own = own[moved[own] > TAKES_PART * moved[own[0]]]
        subjects = tuple(Subject(f"{kind}s", (name,), element) for kind, name, element in (names[k] for k in own))
        together = " together" if len(own) > 1 else ""
        elements = named([f"{s.component} of {s.table[:-1]} {s.names[0]}".removeprefix(" of ") for s in subjects])
        what = f"the observations do not determine {elements}{together}"
        found.append(Finding(Kind.UNDETERMINED, what, CURES[names[own[0]][0]], subjects))
    return found


def reduced_names(structure: Structure, a: EliminationPlan) -> dict[int, tuple[str, str, str]]:
    """Kind of entity, name and element of each unknown of the reduced equations, in elimination order."""
    names = {}
    d, q = a.layout.image, len(structure.interior_columns)
    border = d * a.order.images
    for name, row in zip(structure.image_names, a.order.image, strict=True):
        for k, element in enumerate(structure.exterior_elements):
            names[d * int(row) + k] = ("image", name, element)
    for camera, row in zip(structure.cameras, a.order.camera, strict=True):
        for j, k in enumerate(structure.interior_columns):
            element = camera.model.elements[k] if k < len(camera.model.elements) else f"element {k}"
            at = d * int(row) + 6 + j if d > 6 else border + q * int(row) + j
            names[at] = ("camera", camera.name, element)
    for k, parameter in enumerate(structure.parameters):
        names[border + a.layout.first_parameter + k] = ("parameter", parameter.name, "")
    for k, p in enumerate(a.border_points):
        for c, letter in enumerate("XYZ"):
            row = border + a.layout.first_point + 3 * k + c
            names[row] = ("point", structure.point_names[p], letter)
    return names
