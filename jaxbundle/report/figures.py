"""An adjustment's numbers as numpy arrays in the user's units: converted once, printed many times."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.observations import CONTROL, ObservationGroup
from jaxbundle.io.settings import RADIANS
from jaxbundle.solve.adjustment import Adjustment

HIGH_CORRELATION = 0.95


@dataclass(frozen=True, eq=False)
class Figures:
    """Values and a-posteriori standard deviations (`_sd`): 0 for what is held, NaN where none were computed.

    Angles are in the block's angle unit. `residuals` and `normalised` (v / sigma): the rays, then every group.
    """

    adjustment: Adjustment
    structure: Structure
    vtpv: float
    sigma0: float
    exterior: Float[np.ndarray, "image 6"]
    exterior_sd: Float[np.ndarray, "image 6"]
    interior: Float[np.ndarray, "camera element"]
    interior_sd: Float[np.ndarray, "camera element"]
    points: Float[np.ndarray, "point 3"]
    points_sd: Float[np.ndarray, "point 3"]
    check_differences: Float[np.ndarray, "check 3"]
    residuals: tuple[Float[np.ndarray, "_member _component"], ...]
    normalised: tuple[Float[np.ndarray, "_member _component"], ...]
    rays_of_point: Int[np.ndarray, " point"]
    rays_of_image: Int[np.ndarray, " image"]

    @property
    def unknown_points(self) -> Int[np.ndarray, " unknown"]:
        """Points with a coordinate that is not fixed."""
        return np.flatnonzero(self.structure.point_free.any(1))

    @property
    def control_point(self) -> Bool[np.ndarray, " point"]:
        """Points of which a coordinate is fixed or observed."""
        control = np.zeros(len(self.points), bool)
        control[np.nonzero(~self.structure.point_free)[0]] = True
        for group in self.groups:
            if group.structure.kind is CONTROL:
                control[group.structure.indices[:, 0]] = True
        return control

    @property
    def groups(self) -> tuple[ObservationGroup, ...]:
        """Observations that are no rays."""
        return self.adjustment.block.groups

    @property
    def ray_size(self) -> Float[np.ndarray, " ray"]:
        """The larger of a ray's two |v| / (sigma0 sigma); 0 where nothing is left to be compared with."""
        size = np.abs(self.normalised[0]).max(1, initial=0.0)
        return size / self.sigma0 if self.sigma0 > 0 else np.zeros_like(size)

    def correlations(self) -> list[tuple[int, str, str, float]]:
        """Camera, two of its unknown elements and their correlation, for every pair."""
        if self.adjustment.cofactors is None:
            return []
        matrices = np.asarray(self.adjustment.interior_correlations)
        pairs = []
        for c, camera in enumerate(self.structure.cameras):
            free = np.flatnonzero(self.structure.interior_free[c])
            names = camera.model.elements
            for i, a in enumerate(free):
                pairs += [(c, names[a], names[b], float(matrices[c, a, b])) for b in free[i + 1 :]]
        return pairs


def figures_of(adjustment: Adjustment) -> Figures:
    """The numbers of a concrete adjustment."""
    block, structure = adjustment.block, adjustment.block.structure
    to_unit = np.array([1.0] * 3 + [1 / RADIANS[structure.angle_unit]] * 3)
    exterior_sd, interior_sd, points_sd = _standard_deviations(adjustment)
    exterior = np.hstack([block.exterior.projection_centre, block.exterior.angles])
    return Figures(
        adjustment,
        structure,
        float(adjustment.vtpv),
        float(adjustment.sigma0),
        exterior * to_unit,
        exterior_sd * to_unit,
        np.asarray(block.interior.elements),
        interior_sd,
        np.asarray(block.object_points),
        points_sd,
        np.asarray(adjustment.check_differences),
        tuple(np.asarray(v) for v in adjustment.residuals),
        tuple(np.asarray(v) for v in adjustment.weighted_residuals),
        np.bincount(structure.ray_point, minlength=len(structure.point_names)),
        np.bincount(structure.ray_image, minlength=len(structure.image_names)),
    )


def _standard_deviations(adjustment: Adjustment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    structure = adjustment.block.structure
    free = structure.exterior_free, structure.interior_free, structure.point_free
    if adjustment.cofactors is None:
        computed = (np.nan,) * 3
    else:
        sd = adjustment.standard_deviations
        computed = np.hstack([sd.projection_centre, sd.angles]), np.asarray(sd.interior), np.asarray(sd.object_points)
    exterior, interior, points = (np.where(f, c, 0.0) for f, c in zip(free, computed, strict=True))
    return exterior, interior, points


def member_names(structure: Structure, group: ObservationGroup) -> dict[str, list[str]]:
    """Names of what each member of a group touches, by column: "point", or "point_1" and "point_2"."""
    touches = group.structure.kind.touches
    cameras = tuple(camera.name for camera in structure.cameras)
    names = {"point": structure.point_names, "image": structure.image_names, "camera": cameras}
    return {
        kind if touches.count(kind) == 1 else f"{kind}_{touches[: k + 1].count(kind)}": [
            names[kind][index] for index in group.structure.indices[:, k]
        ]
        for k, kind in enumerate(touches)
    }
