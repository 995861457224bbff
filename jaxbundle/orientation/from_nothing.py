"""The function `approximate`: approximate values of a block from its rays and other given values.

The method depends on the input. If all images have an orientation, their rays are intersected. If most images have at
least four control points, the images are resected. Otherwise all pairs of images are oriented and combined
(`global_start`), and transformed to the object system by control, observed stations or given orientations
(`to_object`). The remaining images are resected from the points known then.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.given import require_a
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.geometry.rotation import apply
from jaxbundle.geometry.vectors import components
from jaxbundle.numerics.host import tree_with
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.orientation.anchors import Given, anchors_of, given_of
from jaxbundle.orientation.approximation import Approximation, Figure, OrientedPart, Step, Way
from jaxbundle.orientation.common_rays import Directions
from jaxbundle.orientation.global_start import GlobalStart, PartOrientation, global_start
from jaxbundle.orientation.oriented import oriented
from jaxbundle.orientation.planes_and_lines import with_planes_and_lines
from jaxbundle.orientation.robust_intersection import Met, Rays, apart, met
from jaxbundle.orientation.scale_joints import without_scale
from jaxbundle.orientation.sight import Sight, direction_sigmas, sight_of
from jaxbundle.orientation.start_findings import Doubts, start_findings
from jaxbundle.orientation.to_object import Basis, Placed, Views, closed_form, placed

CONTROL_RAYS = 4  # minimum control points of an image for a resection
MOST = 0.6  # minimum share of such images for the resection of all
FINEST = 5e-4  # share of the image field: standard deviation of a direction in a start, half of a thousandth
SPREAD = 3.0  # times the standard deviation: misfit of rays before the adjustment
MIN_POINTS = 5  # minimum points of a resection: four and one check
ROUGH = 0.1  # image fields; maximum median angle of an accepted resection
BEHIND = 0.1  # maximum share of the points behind a resected image
WAVES = 20
SUSPECT = 10.0  # in typical misfits; a random position on the image has a much larger misfit
JOINING = 10  # passes with robust weights
FEWEST = 3  # minimum common points to transform a part into the system of another


class State(NamedTuple):
    """The known orientations and points, NaN where unknown."""

    rotation: Float[np.ndarray, "image 3 3"]
    centre: Float[np.ndarray, "image 3"]
    points: Float[np.ndarray, "point 3"]
    believed: Bool[np.ndarray, " ray"]

    @property
    def oriented(self) -> Bool[np.ndarray, " image"]:
        """Mask of the images that have an orientation."""
        return np.asarray(np.isfinite(self.centre).all(1) & np.isfinite(self.rotation).all((1, 2)))


class _Work(NamedTuple):
    """The data of the block for the steps."""

    block: Block
    sight: Sight
    given: Given
    directions: Directions


def approximate(block: Block, *, anew: bool = False) -> Approximation:
    """Computes approximate values of a block: orientations of images without one, and coordinates of points.

    Args:
        block: the block; unknown orientations and coordinates are NaN.
        anew: whether given orientations and points are recomputed. Fixed ones are not changed.

    Returns: the block with approximate values, the steps with their numbers, and findings. Rays that do not agree with
    the others are reported and remain in the block.

    Raises: BlockError for a block without rays, or for sensors other than photographs; ValueError without float64.

    Example:
        >>> import jaxbundle as jb
        >>> start = jb.approximate(jb.read("quarry", check_start=False))
        >>> jb.adjust(start.block).success
        True
    """
    prepare_jax()
    require_a(Block, block, "approximate")
    _require_photographs(block)
    replaced = np.full(len(block.structure.image_names), anew)
    with np.errstate(all="ignore"):
        return _approximate(block, replaced)


def with_images_replaced(block: Block, replaced: Bool[np.ndarray, " image"]) -> Approximation:
    """Implements `approximate` for a concrete block of photographs; the orientations of these images are recomputed."""
    with np.errstate(all="ignore"):
        return _approximate(block, replaced)


def _require_photographs(block: Block) -> None:
    s = block.structure
    if not block.concrete:
        raise ValueError("approximate needs concrete numbers: call it outside jit, grad and vmap")
    if not len(s.ray_image):
        raise BlockError([Problem("the block has no rays", "measure points on its images", "rays")])
    if not s.model.photographs:
        raise BlockError(
            [Problem("the sensors of the block are not photographs", "give approximate values", "cameras")]
        )


def _approximate(block: Block, replaced: Bool[np.ndarray, " image"]) -> Approximation:
    sight = sight_of(block)
    given = given_of(block, replaced)
    sigma = np.maximum(direction_sigmas(block, sight), FINEST * sight.field[sight.image])
    vector = np.c_[sight.plane, -np.ones(len(sight.plane))]
    vector /= np.linalg.norm(vector, axis=1, keepdims=True)
    images, points = len(sight.centre), len(sight.points)
    work = _Work(block, sight, given, Directions(sight.image, sight.point, vector, sigma, images, points))
    way = _way(work)
    rotation = np.where(given.oriented[:, None, None], sight.rotation, np.nan)
    centre = np.where(given.oriented[:, None], sight.centre, np.nan)
    state = State(rotation, centre, np.where(_finite(given.points)[:, None], given.points, np.nan),
                  np.ones(len(sight.image), bool))  # fmt: skip
    steps: list[Step] = []
    parts: list[tuple[np.ndarray, Basis]] = []
    refused = np.zeros(points, bool)
    if way is Way.GLOBAL:
        found = global_start(work.directions)
        steps += found.steps
        state, parts, refused, more = _in_object_system(work, state, found)
        steps += more
    state, number = _waves(work, state)
    if number or way is Way.RESECTION:
        steps.append(Step("resections", (Figure("images", number),)))
    return _answer(work, way, state, (steps, parts, refused))


def _way(work: _Work) -> Way:
    if work.given.oriented.all():
        return Way.GIVEN
    known = _finite(work.given.points)[work.sight.point]
    rays = np.bincount(work.sight.image[known], minlength=len(work.sight.centre))
    return Way.RESECTION if (rays >= CONTROL_RAYS).mean() > MOST else Way.GLOBAL


def _finite(rows: Float[np.ndarray, "row 3"]) -> Bool[np.ndarray, " row"]:
    """Mask of the rows without NaN."""
    return np.asarray(np.isfinite(rows).all(1))


def _rays(work: _Work, state: State, images: Bool[np.ndarray, " image"]) -> tuple[Rays, Int[np.ndarray, " ray"]]:
    """Rays of some images in the object system, and their indices."""
    d = work.directions
    of = np.flatnonzero(images[d.image])
    image = d.image[of]
    rotation = state.rotation.reshape(-1, 9).T[:, image]
    along = np.stack(apply(tuple(rotation), components(d.vector[of])), 1)
    return Rays(image, d.point[of], along, state.centre[image], SPREAD * d.sigma[of], state.believed[of]), of


def _met(work: _Work, state: State, images: Bool[np.ndarray, " image"]) -> tuple[Met, Int[np.ndarray, " ray"]]:
    rays, of = _rays(work, state, images)
    return met(rays, work.directions.points), of


def _in_object_system(
    work: _Work, state: State, found: GlobalStart
) -> tuple[State, list[tuple[np.ndarray, Basis]], Bool[np.ndarray, " point"], list[Step]]:
    """Transforms all parts to the object system; also returns rejected control and the steps."""
    state = state._replace(believed=found.believed)
    parts: list[tuple[np.ndarray, Basis]] = []
    refused, steps = np.zeros(work.directions.points, bool), []
    main: Met | None = None
    for part in found.parts:
        images = np.zeros(work.directions.images, bool)
        images[part.images] = True
        own = _own(work, state, part)
        points, _ = _met(work, own, images)
        at, anchors = _placed(work, part, points)
        if at.basis is Basis.OWN and main is not None:
            joined = _joined(points.points, main.points)
            at = joined or at
        rotation, centre = state.rotation.copy(), state.centre.copy()
        free = images & ~work.given.oriented
        rotation[free] = at.rotation @ own.rotation[free]
        centre[free] = at(own.centre[free])
        state = state._replace(rotation=rotation, centre=centre)
        if main is None:
            main = points._replace(points=at(points.points))
        wrong = anchors.is_point & ~at.used & np.isfinite(at.misfits)
        refused[anchors.number[wrong]] = True
        parts.append((part.images, at.basis))
        steps.append(_placed_step(at, anchors.is_point))
    return state, parts, refused, steps


def _own(work: _Work, state: State, part: PartOrientation) -> State:
    """The part in a separate system."""
    images = work.directions.images
    rotation, centre = np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan)
    rotation[part.images], centre[part.images] = part.rotation.swapaxes(1, 2), part.centre
    return State(rotation, centre, np.full((work.directions.points, 3), np.nan), state.believed)


def _placed(work: _Work, part: PartOrientation, points: Met) -> tuple:
    anchors = anchors_of(work.given, part.images, part.centre, points.points)
    rotation = part.rotation.swapaxes(1, 2)
    return placed(anchors, Views(part.centre, rotation, work.given.attitudes[part.images])), anchors


def _joined(own: Float[np.ndarray, "point 3"], others: Float[np.ndarray, "point 3"]) -> Placed | None:
    """Transforms a part by its common points with another one."""
    common = np.isfinite(own).all(1) & np.isfinite(others).all(1)
    if common.sum() < FEWEST:
        return None
    x, o = own[common], others[common]
    scale, rotation, shift, _ = closed_form(x, o, np.ones(len(x)))
    misfit = np.linalg.norm(scale * x @ rotation.T + shift - o, axis=1)
    for _ in range(JOINING):
        scale, rotation, shift, _ = closed_form(x, o, 1 / (np.median(misfit) ** 2 + misfit**2 + 1e-300))
        misfit = np.linalg.norm(scale * x @ rotation.T + shift - o, axis=1)
    return Placed(float(scale), rotation, shift, Basis.JOINED, misfit, np.ones(len(x), bool))


def _placed_step(at: Placed, is_point: Bool[np.ndarray, " anchor"]) -> Step:
    used = at.misfits[at.used]
    figures = (
        Figure("control points", int((is_point & at.used).sum()) if at.basis is not Basis.JOINED else 0),
        Figure("stations", int((~is_point & at.used).sum()) if at.basis is not Basis.JOINED else 0),
        Figure("rms misfit", float(np.sqrt((used**2).mean())) if len(used) else np.nan),
        Figure("refused", int((~at.used & np.isfinite(at.misfits)).sum())),
    )
    return Step(f"into the object system by {at.basis.value}", figures)


def _waves(work: _Work, state: State) -> tuple[State, int]:
    """Resects the remaining images from the known points, until no further image can be oriented."""
    total = 0
    known = _finite(work.given.points)
    for _ in range(WAVES):
        left = np.flatnonzero(~state.oriented)
        if not len(left):
            break
        points = np.where(known[:, None], work.given.points, np.nan)
        if state.oriented.any():
            found, _ = _met(work, state, state.oriented)
            points = np.where(known[:, None], points, found.points)
        usable = _finite(points)[work.sight.point]
        sight = work.sight._replace(rotation=state.rotation, centre=state.centre)
        of_control = np.isin(work.sight.image, left) & usable & ~known[work.sight.point]
        count = np.bincount(work.sight.image[usable], minlength=len(state.centre))
        other = np.bincount(work.sight.image[of_control], minlength=len(state.centre))
        left = left[count[left] >= np.where(other[left] > 0, MIN_POINTS, CONTROL_RAYS)]
        if not len(left):
            break
        new = oriented(sight, left, np.nan_to_num(points), usable, work.block.structure.rotation_system)
        good = (new.median <= ROUGH * sight.field[left]) & (new.behind <= BEHIND)
        if not good.any():
            break
        rotation, centre = state.rotation.copy(), state.centre.copy()
        rotation[left[good]], centre[left[good]] = new.rotation[good], new.centre[good]
        state = state._replace(rotation=rotation, centre=centre)
        total += int(good.sum())
    return state, total


def _answer(work: _Work, way: Way, state: State, rest: tuple) -> Approximation:
    """The block with all computed values."""
    steps, parts, refused = rest
    block, s = work.block, work.block.structure
    done = state.oriented
    found, of = _met(work, state, done)
    off = np.zeros(len(work.sight.image))
    off[of] = found.off
    typical = max(1.0, _noise(found))
    suspects = np.zeros(len(off), bool)
    several = np.bincount(work.sight.point[of], minlength=len(found.points)) >= 2
    suspects[of] = (found.off > SUSPECT * typical) & several[work.sight.point[of]]
    steps.append(_points_step(found, SPREAD * work.directions.sigma[of], int(suspects.sum())))
    points, behind = _points(work, state, found, refused)
    angles = _angles(work, state)
    held = ~s.exterior_free
    centre = np.where(held[:, :3], np.asarray(block.exterior.projection_centre), state.centre)
    angles = np.where(held[:, 3:], np.asarray(block.exterior.angles), angles)
    start = tree_with(
        lambda b: (b.exterior.projection_centre, b.exterior.angles, b.object_points), block, (centre, angles, points)
    )
    new, _ = with_planes_and_lines(start)
    members = _parts(work, state, parts)
    loose = tuple(s.image_names[k] for k in np.flatnonzero(~done))
    scale = np.zeros(len(done), bool)
    for images, _ in members if way is Way.GLOBAL else ():
        inside = np.isin(np.arange(len(done)), images)
        fits = of[found.fits]
        scale |= without_scale(work.sight.image[fits], work.sight.point[fits], inside)
    scale &= ~_finite(work.given.centres)
    names = tuple(OrientedPart(tuple(s.image_names[k] for k in images), basis) for images, basis in members)
    findings = start_findings(block, names, loose, Doubts(suspects, refused, behind, scale))
    return Approximation(new, way, tuple(steps), names, loose, suspects, findings)


def _points_step(found: Met, sigma: Float[np.ndarray, " ray"], suspects: int) -> Step:
    off = np.degrees(found.off * sigma)[found.fits]
    return Step(
        "points intersected",
        (
            Figure("points", int(np.isfinite(found.points).all(1).sum())),
            Figure("rays that fit", 100 * float(found.fits.mean()) if len(sigma) else 0.0, "%"),
            Figure("median angle off", float(np.median(off)) if len(off) else np.nan, "deg"),
            Figure("suspect rays", suspects),
        ),
    )


def _angles(work: _Work, state: State) -> Float[np.ndarray, "image 3"]:
    """Angles of the new orientations; given angles are not changed."""
    system = work.block.structure.rotation_system
    new = np.stack([np.asarray(x) for x in system.angles_from_rotation(tuple(state.rotation.reshape(-1, 9).T))], 1)
    return np.where(work.given.oriented[:, None], np.asarray(work.block.exterior.angles), new)


def _points(
    work: _Work, state: State, found: Met, refused: Bool[np.ndarray, " point"]
) -> tuple[Float[np.ndarray, "point 3"], Bool[np.ndarray, " point"]]:
    """Coordinates of points: given control, otherwise intersections; and which points lie behind their images.

    A point whose rays do not intersect in front gets the position that `apart` finds.
    """
    points, (rays, _) = found.points.copy(), _rays(work, state, state.oriented)
    count = len(points)
    depth = ((points[rays.point] - rays.centre) * rays.along).sum(1)
    # nearly parallel rays of a rough start may intersect behind their images
    behind = np.bincount(rays.point, ~(depth > 0), count) > 0
    lost = behind & (np.bincount(rays.point, found.fits, count) < 2) & (np.bincount(rays.point, minlength=count) >= 2)
    if lost.any():
        typical = float(np.median(depth[depth > 0])) if (depth > 0).any() else 1.0
        placed_apart = apart(rays, typical, max(1 / SPREAD, _noise(found)), count)
        points = np.where(lost[:, None], placed_apart.points, points)
        lost &= placed_apart.behind
    believed = np.isfinite(work.given.points) & ~refused[:, None]
    points = np.where(believed, work.given.points, points)
    points = np.where(work.block.structure.point_free, points, np.asarray(work.block.object_points))
    return points, lost & ~believed.all(1)


def _noise(found: Met) -> float:
    """Typical angle off of the rays that fit, in standard deviations."""
    return 1.4826 * float(np.median(found.off[found.fits])) if found.fits.any() else 1.0


def _parts(work: _Work, state: State, parts: list[tuple[np.ndarray, Basis]]) -> list[tuple[np.ndarray, Basis]]:
    """Images in common systems: given and resected images belong to the first part."""
    done = state.oriented
    systems = [(images, basis) for images, basis in parts if basis is Basis.OWN]
    if len(systems) == len(parts) and systems:
        systems = systems[1:]
    apart = np.concatenate([np.zeros(0, int), *(images for images, _ in systems)])
    first = np.setdiff1d(np.flatnonzero(done), apart)
    basis = parts[0][1] if parts else Basis.GIVEN
    return [(first, basis), *systems] if len(first) else systems
