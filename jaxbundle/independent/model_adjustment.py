"""The method of independent models: all models of two photographs each in one adjustment with seven unknowns each.

    v = L^-1 (t R^T (X - X0) - x)          of model points and of both projection centres, which connect models

Control, stations, navigation data and all other observations of the block are used as in the bundle (Ackermann,
Ebner, Klein 1973). The method is less rigorous than the bundle: a ray of a common image of two models is used in both
like two measurements, and the interior orientation is fixed.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Unpack

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Subject, in_order
from jaxbundle.block.given import require_a, require_photographs
from jaxbundle.block.problems import BlockError, Problem
from jaxbundle.block.wording import counted, named
from jaxbundle.independent.chains import MIN_COMMON, chains
from jaxbundle.independent.formation import Models, form_models
from jaxbundle.independent.model_block import model_block
from jaxbundle.independent.photograph_orientations import Oriented, Within, oriented_angles, with_orientations
from jaxbundle.independent.propagation import Propagated, model_errors, propagated
from jaxbundle.independent.sensor_block import SensorBlock
from jaxbundle.independent.sensors import unwhitened
from jaxbundle.independent.started import started
from jaxbundle.numerics.program_cache import prepare_jax
from jaxbundle.solve.adjust import Progress, adjust
from jaxbundle.solve.adjustment import Adjustment
from jaxbundle.solve.options import Choices, Options

Pairs = Sequence[tuple[str, str]]


class ModelAdjustment(NamedTuple):
    """The result of the function `adjust_models`.

    Example:
        >>> found = jb.independent.adjust_models(block)
        >>> found.adjustment.success, found.block
        (True, <Block quarry: 4 images, 8 points, 32 rays, 1 camera, 12 control>)
    """

    adjustment: Adjustment
    """The adjustment of the models: its images are the models, with names "first-second", its points are the object
    points, then the projection centres. Standard deviations, redundancy numbers and tests are as in any adjustment."""
    block: Block
    """The photographs with the orientations and points of the models, as a start of the bundle."""
    oriented: Oriented
    """The exterior orientations and their standard deviations for each image; angles in radians."""
    points: Int[np.ndarray, " point"]
    """Indices of the object points of the models in the block of photographs."""
    models: Models
    """The models before the adjustment."""
    findings: tuple[Finding, ...]
    """Findings about unused data, and about points that were left out of models."""

    @property
    def residuals(self) -> Float[np.ndarray, "ray 3"]:
        """Residuals of the model points in the systems of their models, object unit."""
        numbers = np.asarray(self.adjustment.block.rays.coordinates)[:, 3:9]
        return unwhitened(np.asarray(self.adjustment.residuals[0]), numbers)

    @property
    def object_points(self) -> Float[np.ndarray, "point 3"]:
        """Adjusted coordinates of `points`."""
        return np.asarray(self.adjustment.block.object_points)[: len(self.points)]

    def propagated(self) -> Propagated | None:
        """Standard deviations from the errors of the image coordinates, which models share; None for a large block."""
        estimated = len(self.adjustment.block.structure.model.elements) > 1
        rays = len(self.block.structure.ray_image)
        errors = model_errors(self.models, self.adjustment.block, rays, estimated)
        return propagated(self.adjustment, errors)


def adjust_models(
    block: Block,
    options: Options | None = None,
    *,
    pairs: Pairs | None = None,
    estimate_shared_errors: bool = False,
    progress: Callable[[Progress], None] | None = None,
    **choices: Unpack[Choices],
) -> ModelAdjustment:
    """Adjusts a block by the method of independent models.

    Args:
        block: photographs; its interior elements are fixed. Missing orientations are computed first, as by
            `approximate`.
        options: as for `adjust`, also as keywords.
        pairs: names of the two images of each model; if None, successive images of strips.
        estimate_shared_errors: whether the common errors of all points of a model, those of its relative orientation,
            are five additional unknowns of the model. If not, they are included in the covariances of its single
            points.
        progress: a function that is called after each iteration.

    Returns: the adjustment of the models, and the photographs with the adjusted orientations.

    Raises: BlockError for a block whose models cannot be formed or adjusted; ValueError without float64.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxbundle as jb
        >>> found = jb.independent.adjust_models(jb.simulate(1, 3, control_sigma=0.02).block)
        >>> len(found.models)
        2
    """
    require_a(Block, block, "independent.adjust_models")
    prepare_jax()
    require_photographs(block, "independent.adjust_models")
    block, found = started(block)
    models, told = formed(block, pairs)
    of_models = model_block(block, models, estimate_shared_errors)
    adjustment = adjust(of_models.block, options, progress=progress, **choices)
    oriented = _oriented(block, of_models, models, adjustment)
    places = np.full(np.shape(block.object_points), np.nan)
    places[of_models.points] = np.asarray(adjustment.block.object_points)[: len(of_models.points)]
    return ModelAdjustment(
        adjustment,
        with_orientations(block, oriented, places, adjustment.block.parameters),
        oriented,
        of_models.points,
        models,
        in_order((*found, *told, *of_models.findings, *fixed_interior(block))),
    )


def formed(block: Block, pairs: Pairs | None) -> tuple[Models, list[Finding]]:
    """Models of these pairs of images, without those with too few fitting points, and findings.

    Raises: BlockError if no model can be formed.
    """
    structure = block.structure
    wanted = _pairs(block, pairs)
    models = form_models(block, wanted) if len(wanted) else None
    good = models.used.sum(1) >= MIN_COMMON if models is not None else np.zeros(0, bool)
    good &= np.isfinite(models.shared_base).all((1, 2)) if models is not None else good
    if models is None or not good.any():
        cure = f"a model needs two images from different stations with {MIN_COMMON} common points"
        raise BlockError([Problem("no two images form a model", cure, "images")])
    names, told = structure.image_names, []
    if not good.all():
        bad = [f"{names[i]}-{names[j]}" for i, j in models.pair[~good]]
        cure = f"measure more common points; a model needs {MIN_COMMON} points whose rays intersect"
        subjects = tuple(Subject("images", (name,)) for name in bad)
        told.append(Finding(Kind.UNUSED, f"{counted(len(bad), 'model')} not formed: {named(bad)}", cure, subjects))
    models = Models(*(part[good] for part in models))
    return models, [*told, *_left_out(block, models)]


def _pairs(block: Block, pairs: Pairs | None) -> Int[np.ndarray, "model 2"]:
    structure = block.structure
    if pairs is None:
        centres, points = np.asarray(block.exterior.projection_centre), np.asarray(block.object_points)
        strips = chains(structure, centres, points)
        found = [pair for strip in strips for pair in zip(strip[:-1], strip[1:], strict=True)]
        return np.array(found, int).reshape(-1, 2)
    number = {name: k for k, name in enumerate(structure.image_names)}
    unknown = list(dict.fromkeys(name for pair in pairs for name in pair if name not in number))
    same = [first for first, second in pairs if first == second]
    problems = [Problem(f"a model names image {name}, which is not in the block", "drop it") for name in unknown]
    problems += [Problem(f"a model has image {name} twice", "name two different images") for name in same]
    if problems:
        raise BlockError(problems)
    return np.array([[number[first], number[second]] for first, second in pairs], int).reshape(-1, 2)


def _left_out(block: Block, models: Models) -> list[Finding]:
    """Findings about images in no model, points in no model, and points whose rays do not intersect."""
    s, told = block.structure, []
    images = [name for i, name in enumerate(s.image_names) if i not in set(models.pair.ravel().tolist())]
    if images:
        what = f"{counted(len(images), 'image')} in no model: {named(images)}"
        cure = "give pairs of images with common points, or adjust by the bundle method"
        told.append(Finding(Kind.UNUSED, what, cure, tuple(Subject("images", (name,)) for name in images)))
    bad = models.ray[(models.ray[:, :, 0] >= 0) & ~models.used]
    rays = [(s.image_names[s.ray_image[r]], s.point_names[s.ray_point[r]]) for pair in bad for r in pair]
    if len(bad):
        what = f"{counted(len(bad), 'point')} left out of models, because their rays do not intersect: "
        what += named([s.point_names[s.ray_point[a]] for a, _ in bad])
        subjects = tuple(Subject("rays", ray) for ray in rays)
        told.append(Finding(Kind.SUSPECT, what, "re-measure or remove one of the two rays", subjects))
    seen = np.zeros(len(s.point_names), bool)
    seen[models.point[models.used]] = True
    missing = [s.point_names[p] for p in np.flatnonzero(~seen & (np.bincount(s.ray_point, minlength=len(seen)) > 0))]
    if missing:
        what = f"{counted(len(missing), 'point')} in no model: {named(missing)}"
        cure = "they are intersected after the adjustment; the bundle method uses their rays"
        told.append(Finding(Kind.UNUSED, what, cure, tuple(Subject("points", (name,)) for name in missing)))
    return told


def fixed_interior(block: Block) -> list[Finding]:
    """The finding about interior elements that the user wants to estimate."""
    s = block.structure
    rows = np.argwhere(s.interior_free)
    if not len(rows):
        return []
    elements = [f"{s.cameras[c].name} {s.cameras[c].model.elements[k]}" for c, k in rows]
    what = f"the interior elements {named(elements)} are fixed at their approximate values"
    subjects = tuple(Subject("cameras", (s.cameras[c].name,), s.cameras[c].model.elements[k]) for c, k in rows)
    return [Finding(Kind.INFORMATION, what, "estimate interior elements by the bundle method", subjects)]


def _oriented(block: Block, of_models: SensorBlock, models: Models, adjustment: Adjustment) -> Oriented:
    """Orientations of the photographs: centres are tie points, attitudes come from one model each."""
    sensors, count = of_models.sensors, len(block.structure.image_names)
    exterior, sd = np.full((count, 6), np.nan), np.full((count, 6), np.nan)
    images, points = of_models.images, len(of_models.points)
    model = sensors.of_image[images]
    variance, turned = float(adjustment.sigma0) ** 2, models.shared_angles[model]
    second = (models.pair[model, 1] == images)[:, None, None]
    rotation = sensors.rotation[images]
    shared = np.broadcast_to(np.eye(5), (len(images), 5, 5))
    interior = np.asarray(adjustment.block.interior.elements)
    if interior.shape[1] > 1:  # the shared errors are estimated
        rotation = np.where(second, _turned(turned, interior[model, 1:]) @ rotation, rotation)
        shared = np.zeros((len(images), 5, 5))
    q = np.zeros((len(images), 3, 3))
    if adjustment.cofactors is not None:
        q = np.asarray(adjustment.cofactors.exterior)[model, 3:, 3:]
        if interior.shape[1] > 1:
            shared = np.asarray(adjustment.cofactors.interior)[model, 1:, 1:]
        sd[images, :3] = np.asarray(adjustment.standard_deviations.object_points)[points:]
    turns = np.where(second, turned @ shared @ turned.transpose(0, 2, 1), 0.0)
    exterior[images, :3] = np.asarray(adjustment.block.object_points)[points:]
    angles = np.asarray(adjustment.block.exterior.angles)[model]
    # TRAP: the compiled program takes all images, in the block's order
    every = np.zeros(count, int)
    every[images] = np.arange(len(images))
    within = Within(angles[every], variance * q[every], rotation[every], variance * turns[every])
    found, deviations = oriented_angles(block, within)
    exterior[images, 3:] = found[images]
    if adjustment.cofactors is not None:
        sd[images, 3:] = deviations[images]
    return Oriented(exterior, sd)


def _turned(
    turns: Float[np.ndarray, "image 3 5"], errors: Float[np.ndarray, "image 5"]
) -> Float[np.ndarray, "image 3 3"]:
    """Rotation matrices of the small rotations from the estimated errors."""
    x, y, z = np.einsum("mke,me->km", turns, errors)
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    left, _, right = np.linalg.svd(np.eye(3) + skew + skew @ skew / 2)
    return left @ right
