"""The numbers of an adjustment as numpy arrays in the user's units: converted once for all parts of a report."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Structure
from jaxbundle.block.findings import Finding
from jaxbundle.block.observation_kinds import CONTROL, ObservationGroup
from jaxbundle.block.wording import RADIANS
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.report.group_tables import GroupTable, group_tables
from jaxbundle.solve.adjustment import DOWN_WEIGHTED, Adjustment
from jaxbundle.statistics.reliability_tables import Reliability, reliability
from jaxbundle.statistics.significance import parameter_ratios


@dataclass(frozen=True, eq=False)
class Figures:
    """Values and a-posteriori standard deviations (`_sd`): 0 for fixed values, NaN where none were computed.

    Angles are in the block's angle unit. `residuals` and `normalised` (v / sigma): the rays, then each group.
    """

    adjustment: Adjustment
    structure: Structure
    vtpv: float
    sigma0: float
    exterior: Float[np.ndarray, "image 6"]
    exterior_sd: Float[np.ndarray, "image 6"]
    interior: Float[np.ndarray, "camera element"]
    interior_sd: Float[np.ndarray, "camera element"]
    parameters: Float[np.ndarray, " parameter"]
    parameters_sd: Float[np.ndarray, " parameter"]
    points: Float[np.ndarray, "point 3"]
    points_sd: Float[np.ndarray, "point 3"]
    check_differences: Float[np.ndarray, "check 3"]
    residuals: tuple[Float[np.ndarray, "_member _component"], ...]
    normalised: tuple[Float[np.ndarray, "_member _component"], ...]
    tables: list[GroupTable]
    reliability: Reliability | None
    findings: tuple[Finding, ...]
    rays_of_point: Int[np.ndarray, " point"]
    rays_of_image: Int[np.ndarray, " image"]

    @property
    def unknown_points(self) -> Int[np.ndarray, " unknown"]:
        """Indices of points with a coordinate that is not fixed."""
        return np.flatnonzero(self.structure.point_free.any(1))

    @property
    def control_point(self) -> Bool[np.ndarray, " point"]:
        """Indices of points with a fixed or observed coordinate."""
        control = np.zeros(len(self.points), bool)
        control[np.nonzero(~self.structure.point_free)[0]] = True
        for group in self.groups:
            if group.structure.kind.name == CONTROL.name:  # an unpickled adjustment has its own objects of the kinds
                control[group.structure.indices[:, 0]] = True
        return control

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self.structure.cameras)

    @property
    def groups(self) -> tuple[ObservationGroup, ...]:
        """Groups of observations other than rays."""
        return self.adjustment.block.groups

    @property
    def ray_size(self) -> Float[np.ndarray, " ray"]:
        """The maximum of a ray's two |w| / sigma0, or |v| / (sigma0 sigma) where there is no w; 0 for sigma0 = 0."""
        size = np.abs(self.normalised[0] if self.reliability is None else self.reliability.w[0]).max(1, initial=0.0)
        return size / self.sigma0 if self.sigma0 > 0 else np.zeros_like(size)

    @property
    def weights(self) -> Float[np.ndarray, " ray"] | None:
        """Robust weights of the rays; None where they have none."""
        robust = self.adjustment.reweighting
        return None if robust is None else np.asarray(robust.weights)

    @property
    def down_weighted(self) -> Int[np.ndarray, " ray"]:
        """Indices of rays that lost more than half of their weight, the minimum weight first."""
        if self.weights is None:
            return np.zeros(0, int)
        rays = np.flatnonzero(self.weights < DOWN_WEIGHTED)
        return rays[np.argsort(self.weights[rays], kind="stable")]

    @property
    def significance(self) -> Float[np.ndarray, " parameter"]:
        """|value| / sd of the parameters; NaN where it has no meaning: fixed, undetermined, 0 not special."""
        return parameter_ratios(self.adjustment)

    def correlations(self) -> list[tuple[int, str, str, float]]:
        """Camera, two of its unknown elements and their correlation, for each pair."""
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


def figures_of(adjustment: Adjustment, found: tuple[Finding, ...] | None = None) -> Figures:
    """The numbers of a concrete adjustment. `found`: its findings; if None, they are computed."""
    block, structure = adjustment.block, adjustment.block.structure
    to_unit = np.array([1.0] * 3 + [1 / RADIANS[structure.angle_unit]] * 3)
    is_angle = np.array([parameter.angle for parameter in structure.parameters], bool)
    parameter_unit = np.where(is_angle, to_unit[3], 1.0)
    exterior_sd, interior_sd, parameters_sd, points_sd = _standard_deviations(adjustment)
    found_reliability = None if adjustment.redundancy_numbers is None else reliability(adjustment)
    nothing = tuple(np.full(v.shape, np.nan) for v in adjustment.residuals)
    r, w = found_reliability[:2] if found_reliability else (nothing, nothing)
    residuals = tuple(np.asarray(v) for v in adjustment.residuals)
    normalised = tuple(np.asarray(v) for v in adjustment.weighted_residuals)
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
        np.asarray(block.parameters) * parameter_unit,
        parameters_sd * parameter_unit,
        np.asarray(block.object_points),
        points_sd,
        np.asarray(adjustment.check_differences),
        residuals,
        normalised,
        group_tables(block, residuals[1:], normalised[1:], r[1:], w[1:]),
        found_reliability,
        findings(adjustment) if found is None else found,
        np.bincount(structure.ray_point, minlength=len(structure.point_names)),
        np.bincount(structure.ray_image, minlength=len(structure.image_names)),
    )


def _standard_deviations(adjustment: Adjustment) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations of exterior orientations, interior elements, parameters and points."""
    structure = adjustment.block.structure
    free = structure.exterior_free, structure.interior_free, structure.parameter_free, structure.point_free
    if adjustment.cofactors is None:
        computed = (np.nan,) * 4
    else:
        sd = adjustment.standard_deviations
        exterior = np.hstack([sd.projection_centre, sd.angles])
        computed = exterior, *map(np.asarray, (sd.interior, sd.parameters, sd.object_points))
    exterior, interior, parameters, points = (np.where(f, c, 0.0) for f, c in zip(free, computed, strict=True))
    return exterior, interior, parameters, points
