"""Finding rays that prevent a block from converging, or that make its result unusable.

Gross errors of thousands of pixels distort a least-squares solution so much that large residuals also occur at correct
rays. The approximate values are not yet distorted: rays with residuals many times larger than those of the others are
left out first, and those that still do not fit afterwards are wrong. If this fails, robust weights
(solve/reweighting.py) are tried. The findings are single rays, rays with exchanged names or axes, control points that
contradict all their rays, or whole images.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observation_kinds import CONTROL
from jaxbundle.block.residuals import observations_of, ray_residuals
from jaxbundle.block.unknowns import unknowns_of
from jaxbundle.block.wording import counted, figure, named
from jaxbundle.diagnosis.rays_in_words import ray_name, ray_subject
from jaxbundle.numerics.host import tree_with
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment, Status
from jaxbundle.solve.attempt import attempt
from jaxbundle.solve.weight_functions import Danish
from jaxbundle.statistics.hypotheses import image_points

CURED = 0.3  # maximum share of sigma0 that remains without the named rays
# times the median residual of the start: errors of rough values are smaller; all rays are tested at the end
FAR_OFF = 5.0
OUTLYING = 10.0  # times sigma at the end: not a random error
NO_WEIGHT = 1e6  # times its sigma: a ray with practically no weight
MAX_WRONG = 0.1  # share of the rays: if more are left out, the wrong rays may have been chosen
WHOLE_IMAGE = 0.5  # an image is named instead of its rays from this share of rays
ITERATIONS = 50  # maximum number for one adjustment
SAME_PLACE = 0.1  # share of the distance of two image points: below this the exchanged names fit


def wrong_rays(start: Block, adjustment: Adjustment) -> tuple[Finding, ...]:
    """Findings about rays or images without which the block converges; none if no choice of rays helps."""
    without = _without_far_off(start) or _robust(start)
    if without is None:
        return ()
    found, low = without
    after = float(found.sigma0)
    cured = after <= CURED * float(adjustment.sigma0) or adjustment.status is not Status.CONVERGED
    if not cured or not 0 < len(low) <= MAX_WRONG * len(start.structure.ray_image):
        return ()
    v = np.asarray(found.residuals[0])
    low = low[np.argsort(-np.linalg.norm(v[low], axis=1), kind="stable")]
    images, low = _whole_images(start, low)
    control, low = _whole_control(start, low)
    pairs, low = _exchanged(start, low, v)
    left = f"without them the adjustment converges with sigma0 {after:.4g}"
    return (
        *(_image(start, image, left) for image in images),
        *(_control(start, point, left) for point in control),
        *(_pair(start, pair, left) for pair in pairs),
        *([_single(start, low, v, left)] if len(low) else []),
    )


def _without_far_off(start: Block) -> tuple[Adjustment, Int[np.ndarray, " wrong"]] | None:
    """The adjustment without the rays that are far off at the start, and those of them that do not fit it."""
    sigmas = np.asarray(start.rays.sigmas)
    v = np.asarray(ray_residuals(unknowns_of(start), observations_of(start))).T / sigmas
    size = np.linalg.norm(v, axis=1)
    far = np.flatnonzero(~(size <= FAR_OFF * np.nanmedian(size)))
    if not 0 < len(far) <= MAX_WRONG * len(size):
        return None
    loose = sigmas.copy()
    loose[far] *= NO_WEIGHT
    found = attempt(tree_with(lambda b: b.rays.sigmas, start, loose), max_iterations=ITERATIONS)
    if found is None:
        return None
    return found, _outlying(start, found, far)


def _robust(start: Block) -> tuple[Adjustment, Int[np.ndarray, " wrong"]] | None:
    """The robust adjustment, and the rays that lost their weight."""
    found = attempt(start, robust=Danish(), max_iterations=ITERATIONS)
    if found is None or found.reweighting is None:
        return None
    return found, _outlying(start, found, np.flatnonzero(np.asarray(found.reweighting.weights) < DOWN_WEIGHTED))


def _outlying(start: Block, found: Adjustment, rays: Int[np.ndarray, " candidate"]) -> Int[np.ndarray, " wrong"]:
    """Indices of rays whose residuals are not random errors."""
    size = np.linalg.norm(np.asarray(found.residuals[0])[rays] / np.asarray(start.rays.sigmas)[rays], axis=1)
    return rays[size > OUTLYING * max(float(found.sigma0), 1.0)]


def _whole_images(start: Block, low: Int[np.ndarray, " wrong"]) -> tuple[list[int], Int[np.ndarray, " left"]]:
    """Images with mostly wrong rays, and the wrong rays of the other images."""
    structure, count = start.structure, len(start.structure.image_names)
    rays, wrong = (np.bincount(x, minlength=count) for x in (structure.ray_image, structure.ray_image[low]))
    whole = wrong > WHOLE_IMAGE * np.maximum(rays, 1)
    return np.flatnonzero(whole).tolist(), low[~whole[structure.ray_image[low]]]


def _whole_control(start: Block, low: Int[np.ndarray, " wrong"]) -> tuple[list[int], Int[np.ndarray, " left"]]:
    """Control points with only wrong rays (their coordinates or their only ray are wrong), and the other wrong rays."""
    structure, count = start.structure, len(start.structure.point_names)
    rays, wrong = (np.bincount(x, minlength=count) for x in (structure.ray_point, structure.ray_point[low]))
    observed = [g.structure.indices[:, 0] for g in start.groups if g.structure.kind.table == CONTROL.table]
    known = np.array(~structure.point_free.all(1))
    known[np.concatenate([np.zeros(0, int), *observed])] = True
    whole = known & (wrong > 0) & (wrong == rays)
    return np.flatnonzero(whole).tolist(), low[~whole[structure.ray_point[low]]]


def _exchanged(
    start: Block, low: Int[np.ndarray, " wrong"], v: Float[np.ndarray, "ray 2"]
) -> tuple[list[tuple[int, int]], Int[np.ndarray, " left"]]:
    """Pairs of rays of one image whose measured and computed positions are exchanged, and the other rays."""
    x, image = image_points(start), start.structure.ray_image
    pairs: list[tuple[int, int]] = []
    left = low.tolist()
    while left:
        a = left.pop(0)
        for b in [b for b in left if image[b] == image[a]]:
            apart = x[b] - x[a]
            tolerance = SAME_PLACE * np.linalg.norm(apart)
            if max(np.linalg.norm(v[a] - apart), np.linalg.norm(v[b] + apart)) < tolerance:
                pairs.append((a, b))
                left.remove(b)
                break
    taken = {ray for pair in pairs for ray in pair}
    return pairs, np.array([ray for ray in low.tolist() if ray not in taken], int)


def _image(start: Block, image: int, left: str) -> Finding:
    name = start.structure.image_names[image]
    cure = "check its camera, its resolution and its name, or remove it"
    what = f"most rays of image {name} do not agree with the other images; {left}"
    return Finding(Kind.SUSPECT, what, cure, (Subject("images", (name,)),))


def _control(start: Block, point: int, left: str) -> Finding:
    """The finding about a control point that contradicts all its rays."""
    structure = start.structure
    name, rays = structure.point_names[point], np.flatnonzero(structure.ray_point == point).tolist()
    subjects = (Subject("control", (name,)),)
    if len(rays) > 1:
        what = f"control point {name} contradicts all its {len(rays)} rays"
        return Finding(Kind.SUSPECT, f"{what}; {left}", "check its coordinates and its name", subjects)
    what = f"control point {name} and its only ray, {ray_name(structure, rays[0])}, contradict each other"
    cure = "check the coordinates, the name and the image point"
    return Finding(Kind.SUSPECT, f"{what}; {left}", cure, (*subjects, ray_subject(structure, rays[0])))


def _pair(start: Block, pair: tuple[int, int], left: str) -> Finding:
    one, two = (ray_subject(start.structure, ray) for ray in pair)
    what = f"the names of points {one.names[1]} and {two.names[1]} are exchanged on image {one.names[0]}; {left}"
    return Finding(Kind.SUSPECT, what, "exchange them back", (one, two))


def _single(start: Block, rays: Int[np.ndarray, " wrong"], v: Float[np.ndarray, "ray 2"], left: str) -> Finding:
    """The finding about wrong rays, the largest residuals first."""
    structure = start.structure
    size = np.linalg.norm(v[rays], axis=1)
    unit = structure.cameras[structure.image_camera[structure.ray_image[rays[0]]]].image_unit
    listed = named([f"{ray_name(structure, r)} ({figure(s)} {unit})" for r, s in zip(rays.tolist(), size, strict=True)])
    verb = "disagrees" if len(rays) == 1 else "disagree"
    what = f"{counted(len(rays), 'ray')} {verb} with the others: {listed}"
    cure = "re-measure or remove them"
    if _axes_exchanged(start, rays, v).all():
        what, cure = f"{what}; x and y are exchanged", "exchange x and y of these rays"
    subjects = tuple(ray_subject(structure, ray) for ray in rays.tolist())
    return Finding(Kind.SUSPECT, f"{what}; {left}", cure, subjects, float(size[0]), unit)


def _axes_exchanged(
    start: Block, rays: Int[np.ndarray, " wrong"], v: Float[np.ndarray, "ray 2"]
) -> Bool[np.ndarray, " wrong"]:
    """Whether the computed positions of rays agree with the measured ones after an exchange of x and y."""
    structure, given = start.structure, np.asarray(start.rays.coordinates)[rays]
    up = np.where(structure.rays_downward[rays], -1.0, 1.0)
    computed = given + v[rays] * np.stack([np.ones(len(rays)), up], 1)
    left = np.linalg.norm(computed - given[:, ::-1], axis=1)
    return left < SAME_PLACE * np.linalg.norm(computed - given, axis=1)
