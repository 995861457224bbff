"""Joining models to strips: attitude and scale are transferred from model to model.

The common photograph of two successive models has one attitude and one projection centre S. The scale of the next
model is the weighted mean ratio of distances from S to the common points in both models,

    log s' = log s + sum w (log |x_p - b| - log |x'_p|)

and its errors accumulate along the strip (Kraus 2007, ch. 4.5). Each strip is in the system of its first photograph.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from jaxbundle.independent.formation import Models

MIN_TRANSFER = 3  # minimum number of common points for the transfer of the scale
MAD = 1.4826  # ratio of standard deviation and median absolute deviation of normal numbers
REJECTED = 4.0  # limit in these standard deviations
LOOSE = 0.05  # relative scatter of the scale ratios: above this, models are not joined


class Strip(NamedTuple):
    """A strip in the system of its first photograph, object unit.

    Errors: columns are those of image coordinates, two per ray, of variance 1.
    """

    images: Int[np.ndarray, " image"]
    models: Int[np.ndarray, " model"]
    rotation: Float[np.ndarray, "image 3 3"]
    """Matrices strip_from_image."""
    centres: Float[np.ndarray, "image 3"]
    points: Int[np.ndarray, " point"]
    coordinates: Float[np.ndarray, "point 3"]
    """Mean coordinates over the models of the strip."""
    covariances: Float[np.ndarray, "point 3 3"]
    """Errors of the points within one model, which vary from point to point."""
    centre_covariances: Float[np.ndarray, "image 3 3"]
    scatter: float
    """Relative scatter of the scale ratios, the maximum of all joints."""
    errors: sp.csr_matrix
    """Errors of the coordinates of the points, then of the centres; three rows each."""


class _State(NamedTuple):
    """Scale, attitude and first centre of a model within the strip, with their errors."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    centre: Float[np.ndarray, "3"]
    scale_error: sp.csr_matrix
    """Relative, 1 row."""
    turn: sp.csr_matrix
    """3 rows."""
    shift: sp.csr_matrix
    """3 rows."""


def joined(
    models: Models, chain: list[int], covariances: dict[int, Float[np.ndarray, "_point 3 3"]], rays: int
) -> tuple[Strip, ...]:
    """The strips of a chain of models, each the continuation of the one before; one strip unless a joint is weak.

    `covariances`: of the used points of each model and of both its centres, within the model; `rays`: number of
    rays of the photographs.
    """
    strips, part, state = [], [], _first(rays)
    states: list[_State] = []
    scatter = 0.0
    for k in chain:
        if part:
            after = _carried(models, part[-1], k, states[-1], rays)
            if after is None:
                strips.append(_strip(models, part, states, covariances, scatter))
                part, states, scatter, state = [], [], 0.0, _first(rays)
            else:
                state, loose = after
                scatter = max(scatter, loose)
        part.append(k)
        states.append(state)
    return (*strips, _strip(models, part, states, covariances, scatter))


def _first(rays: int) -> _State:
    nothing = sp.csr_matrix((3, 2 * rays))
    return _State(1.0, np.eye(3), np.zeros(3), nothing[:1], nothing, nothing)


def point_errors(models: Models, m: int, used: Int[np.ndarray, " used"], rays: int) -> sp.csr_matrix:
    """Errors of the used points of a model in its system, three rows each."""
    columns = (2 * models.ray[m, used][:, :, None] + np.arange(2)).reshape(len(used), 4)
    row = np.repeat(np.arange(3 * len(used)), 4)
    own = sp.csr_matrix(
        (models.own[m, used].ravel(), (row, np.repeat(columns, 3, axis=0).ravel())), (3 * len(used), 2 * rays)
    )
    shared = sp.csr_matrix(models.shared[m, used].reshape(-1, 5))
    return sp.csr_matrix(own + shared @ element_errors(models, m, rays))


def element_errors(models: Models, m: int, rays: int) -> sp.csr_matrix:
    """Errors e of the five elements of a model."""
    used = np.flatnonzero(models.used[m])
    columns = (2 * models.ray[m, used][:, :, None] + np.arange(2)).ravel()
    values = models.elements[m, used].transpose(1, 0, 2).reshape(5, -1)
    row = np.repeat(np.arange(5), len(columns))
    return sp.csr_matrix((values.ravel(), (row, np.tile(columns, 5))), (5, 2 * rays))


def _carried(models: Models, k: int, after: int, state: _State, rays: int) -> tuple[_State, float] | None:
    """Scale, attitude and centre of the next model; None if there are too few points for the scale."""
    before, behind = np.flatnonzero(models.used[k]), np.flatnonzero(models.used[after])
    _, a, b = np.intersect1d(models.point[k, before], models.point[after, behind], return_indices=True)
    if len(a) < MIN_TRANSFER:
        return None
    a, b = before[a], behind[b]
    y, x = models.coordinates[k, a] - models.base[k], models.coordinates[after, b]
    ratio = np.log(np.linalg.norm(y, axis=1) / np.linalg.norm(x, axis=1))
    middle = np.median(ratio)
    spread = MAD * np.median(np.abs(ratio - middle))
    if spread > LOOSE:
        return None
    good = np.abs(ratio - middle) <= REJECTED * max(spread, 1e-12)
    a, b, y, x, ratio = a[good], b[good], y[good], x[good], ratio[good]
    variance = [np.einsum("pij,pij->p", models.own[m, p], models.own[m, p]) for m, p in ((k, a), (after, b))]
    weight = 1 / (variance[0] / np.sum(y**2, 1) + variance[1] / np.sum(x**2, 1))
    weight /= weight.sum()
    e = element_errors(models, k, rays)
    base = sp.csr_matrix(models.shared_base[k]) @ e
    along_y = _rows(weight[:, None] * y / np.sum(y**2, 1)[:, None])
    along_x = _rows(weight[:, None] * x / np.sum(x**2, 1)[:, None])
    of_base = sp.csr_matrix((weight[:, None] * y / np.sum(y**2, 1)[:, None]).sum(0)[None]) @ base
    scale_error = state.scale_error + along_y @ point_errors(models, k, a, rays) - of_base
    scale_error = scale_error - along_x @ point_errors(models, after, b, rays)
    turned = state.rotation @ models.base[k] * state.scale
    turn = state.turn + sp.csr_matrix(state.rotation @ models.shared_angles[k]) @ e
    shift = state.shift + _moved(turned[None], state) + sp.csr_matrix(state.scale * state.rotation) @ base
    scale = state.scale * float(np.exp(weight @ ratio))
    new = _State(scale, state.rotation @ models.rotation[k], state.centre + turned, scale_error, turn, shift)
    return new, float(spread)


def _rows(vectors: Float[np.ndarray, "point 3"]) -> sp.csr_matrix:
    """One row with all vectors one after the other."""
    return sp.csr_matrix(vectors.reshape(1, -1))


def _moved(vectors: Float[np.ndarray, "point 3"], state: _State) -> sp.csr_matrix:
    """Errors of vectors due to errors of scale and attitude: d log s v + turn x v, three rows each."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], 1).reshape(-1, 3)  # turn x v = -[v]x turn
    return sp.csr_matrix(sp.csr_matrix(vectors.reshape(-1, 1)) @ state.scale_error + sp.csr_matrix(cross) @ state.turn)


def _strip(
    models: Models,
    part: list[int],
    states: list[_State],
    covariances: dict[int, Float[np.ndarray, "_point 3 3"]],
    scatter: float,
) -> Strip:
    """Points of all models of a strip in one system; the mean for a point in several models."""
    shape = states[0].turn.shape
    assert shape is not None  # the type of a sparse matrix permits it
    rays = int(shape[1]) // 2
    images = np.array([models.pair[part[0], 0], *models.pair[part, 1]])
    last = states[-1]
    rotation = np.stack([*(s.rotation for s in states), last.rotation @ models.rotation[part[-1]]])
    end = last.scale * last.rotation @ models.base[part[-1]]
    centres = np.stack([*(s.centre for s in states), last.centre + end])
    base = sp.csr_matrix(last.scale * last.rotation @ models.shared_base[part[-1]])
    end_error = last.shift + _moved(end[None], last) + base @ element_errors(models, part[-1], rays)
    centre_errors = sp.vstack([*(s.shift for s in states), end_error])
    point, x, q, errors, of_centres = [], [], [], [], np.zeros((len(images), 3, 3))
    for k, (m, s) in enumerate(zip(part, states, strict=True)):
        used = np.flatnonzero(models.used[m])
        turned = s.scale * models.coordinates[m, used] @ s.rotation.T
        rotated = sp.kron(sp.identity(len(used)), sp.csr_matrix(s.scale * s.rotation))
        shift = sp.vstack([s.shift] * len(used))
        errors.append(rotated @ point_errors(models, m, used, rays) + _moved(turned, s) + shift)
        here = s.scale**2 * s.rotation @ covariances[m] @ s.rotation.T
        point.append(models.point[m, used])
        x.append(turned + s.centre)
        q.append(here[:-2])
        of_centres[k : k + 2] = np.where(of_centres[k : k + 2] == 0, here[-2:], (of_centres[k : k + 2] + here[-2:]) / 2)
    points, of_point, count = np.unique(np.concatenate(point), return_inverse=True, return_counts=True)
    mean = sp.csr_matrix((1 / count[of_point], (of_point, np.arange(len(of_point)))), (len(points), len(of_point)))
    coordinates = mean @ np.concatenate(x)
    single = (mean @ np.concatenate(q).reshape(-1, 9)).reshape(-1, 3, 3) / count[:, None, None]
    means = sp.kron(mean, sp.identity(3)) @ sp.vstack(errors)
    return Strip(
        images,
        np.array(part),
        rotation,
        centres,
        points,
        coordinates,
        single,
        of_centres,
        scatter,
        sp.csr_matrix(sp.vstack([means, centre_errors])),
    )
