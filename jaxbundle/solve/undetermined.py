"""Which unknowns the observations leave undetermined, in the user's names, with what would determine them."""

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.normals.arrange import Arrangement
from jaxbundle.normals.cofactors import Cofactors
from jaxbundle.normals.reduced_system import ReducedSystem
from jaxbundle.numerics.host import on_host

WEAKEST_SHARE = 1e-11  # of its own normal equation: below, rounding decides about the unknown
MOST_NAMED = 3000  # kept unknowns; beyond, only where the factorisation failed is told
CURES = {
    "image": "measure more and better spread points on the image, or add control",
    "camera": "hold the element, give control in relief, or add convergent and turned images",
    "parameter": "hold it, give it a prior value with a sigma, or observe more of what it acts on",
    "point": "measure the point on one more image from elsewhere, give it coordinates or drop it",
}


def undetermined_unknowns(structure: Structure, arrangement: Arrangement, cofactors: Cofactors) -> tuple[Finding, ...]:
    """One finding for each direction in which the unknowns can move without any observation noticing."""
    a = arrangement
    shares = np.ones(a.order.points)
    shares[: a.places] = on_host(cofactors.point_pivots).ravel()
    loose = np.nonzero(~(shares[a.order.point] > WEAKEST_SHARE))[0]
    found = [_finding("point", f"point {structure.point_names[p]}", structure.point_names[p]) for p in loose]
    pivots = np.concatenate([np.asarray(cofactors.image_pivots).ravel(), np.asarray(cofactors.border_pivots)])
    if np.all(pivots > WEAKEST_SHARE):
        return tuple(found)
    names = kept_names(structure, a)
    if len(pivots) > MOST_NAMED:
        failed = [names[k] for k in np.nonzero(~(pivots > WEAKEST_SHARE))[0][:1] if k in names]
        return (*found, *(_finding(kind, f"{name} or one that is tied to it", name) for kind, name in failed))
    matrix = _scaled_matrix(cofactors.system, np.asarray(a.reduced.pair))
    if not np.isfinite(matrix).all():
        return tuple(found)
    values, vectors = np.linalg.eigh(matrix)
    for vector in vectors.T[values <= WEAKEST_SHARE]:
        large = [k for k in np.argsort(-np.abs(vector), kind="stable")[:6] if k in names]
        large = [k for k in large if abs(vector[k]) > 0.3 * np.abs(vector).max()]
        moved = ", ".join(names[k][1] for k in large)
        moved = f"{moved}{' (together)' if len(large) > 1 else ''}"
        found.append(_finding(names[large[0]][0], moved, *(names[k][1] for k in large)))
    return tuple(found)


def _finding(kind: str, what: str, *names: str) -> Finding:
    return Finding(Kind.UNDETERMINED, what, CURES[kind], tuple(Subject(f"{kind}s", (name,)) for name in names))


def _scaled_matrix(system: ReducedSystem, pair: Int[np.ndarray, "pair 2"]) -> Float[np.ndarray, "kept kept"]:
    """The reduced matrix in one piece, scaled to the unit diagonal of N; held unknowns have a unit row."""
    images, d = system.diagonal.shape
    used = pair[:, 0] < images
    lower = np.zeros((images, d, images, d))
    i, j = pair[used].T
    lower[i, :, j] = np.asarray(system.pool)[used]
    lower[j, :, i] = np.asarray(system.pool)[used].transpose(0, 2, 1)
    coupling = np.asarray(system.coupling).reshape(images * d, -1)
    matrix = np.block([[lower.reshape(images * d, -1), coupling], [coupling.T, np.asarray(system.border)]])
    free = np.concatenate([np.asarray(system.free).ravel(), np.asarray(system.border_free)])
    diagonal = np.concatenate([np.asarray(system.diagonal).ravel(), np.asarray(system.border_diagonal)])
    scale = np.where(free & (diagonal > 0), 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    return scale[:, None] * matrix * scale + np.diag(np.where(free, 0.0, 1.0))


def kept_names(structure: Structure, a: Arrangement) -> dict[int, tuple[str, str]]:
    """Kind and name of every kept unknown by its row in the order of elimination."""
    names = {}
    d, q = a.shape.image, len(structure.interior_columns)
    border = d * a.order.images
    for name, row in zip(structure.image_names, a.order.image, strict=True):
        for k, element in enumerate(structure.exterior_elements):
            names[d * int(row) + k] = ("image", f"{element} of image {name}")
    for camera, row in zip(structure.cameras, a.order.camera, strict=True):
        for j, k in enumerate(structure.interior_columns):
            element = camera.model.elements[k] if k < len(camera.model.elements) else f"element {k}"
            at = d * int(row) + 6 + j if d > 6 else border + q * int(row) + j
            names[at] = ("camera", f"{element} of camera {camera.name}")
    for k, parameter in enumerate(structure.parameters):
        names[border + a.shape.first_parameter + k] = ("parameter", parameter.name)
    for k, p in enumerate(a.kept):
        for c, letter in enumerate("XYZ"):
            row = border + a.shape.first_kept_point + 3 * k + c
            names[row] = ("point", f"{letter} of point {structure.point_names[p]}")
    return names
