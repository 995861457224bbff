"""The result of an adjustment: adjusted block, residuals, sigma0, cofactors and derived values."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Finding, Kind, Severity, of_kind
from jaxbundle.block.named import CameraValues, ImageValues, Named, PointValues
from jaxbundle.block.notebook import result_html
from jaxbundle.block.wording import counted
from jaxbundle.normals.pcg import TOLERANCE
from jaxbundle.numerics.host import is_concrete, on_host_or_traced
from jaxbundle.numerics.offered import offered
from jaxbundle.solve.history import History
from jaxbundle.solve.options import Options
from jaxbundle.solve.status import Status
from jaxbundle.solve.weight_functions import with_weights

REDUCED = {
    "dense": "dense Cholesky factorisation",
    "panels": "sparse Cholesky factorisation in panels of images",
    "pcg": f"preconditioned conjugate gradients to {TOLERANCE:.0e} of the right-hand side",
}
UNKNOWN = "traced, or many adjustments"  # shown in place of numbers
DOWN_WEIGHTED = 0.5  # rays with a smaller robust weight are listed


class Iterations(NamedTuple):
    """Statistics of the iterations of a solve.

    `measure`: value of the stopping rule at the last accepted step; `step`: |J d| / |v| of the last step if it was not
    damped, else 0. `history`: all iterations; empty if the solver does not report them.
    """

    status: Int[Array, ""]
    trials: Int[Array, ""]
    accepted: Int[Array, ""]
    initial_cost: Float[Array, ""]
    final_cost: Float[Array, ""]
    measure: Float[Array, ""]
    step: Float[Array, ""]
    history: History


class StandardDeviations(NamedTuple):
    """A-posteriori standard deviations, angles in radians; 0 for fixed elements."""

    projection_centre: Float[Array, "image 3"]
    angles: Float[Array, "image 3"]
    interior: Float[Array, "camera element"]
    object_points: Float[Array, "point 3"]
    parameters: Float[Array, " parameter"]


class BlockCofactors(NamedTuple):
    """Blocks of the cofactor matrix; angles of the user's rotation system in radians; 0 for fixed elements."""

    exterior: Float[Array, "image 6 6"]
    interior: Float[Array, "camera element element"]
    object_points: Float[Array, "point 3 3"]
    parameters: Float[Array, "parameter parameter"]

    def standard_deviations(self, sigma0: Any) -> StandardDeviations:
        """Standard deviations of all unknowns, for a given standard deviation of unit weight."""
        return StandardDeviations(*_standard_deviations(sigma0, [_roots(cofactors) for cofactors in self]))

    @property
    def interior_correlations(self) -> Float[Array, "camera element element"]:
        """Correlations of the interior elements of each camera; 0 for fixed elements."""
        return _correlations(self.interior, _roots(self.interior))


class Reweighting(eqx.Module):
    """Robust weights of the rays, 1 for full weight; the weight function and its limit.

    `settled`: whether the weights have converged.
    """

    name: str = eqx.field(static=True)
    limit: float = eqx.field(static=True)
    rounds: int = eqx.field(static=True)
    weights: Float[Array, " ray"]
    settled: bool = eqx.field(static=True, default=True)


class Adjustment(eqx.Module):
    """An adjusted block with its residuals and precision.

    `residuals`: rays first (unit of the rays, y up), then each group of `block.groups`.

    `redundancy_numbers` have the same structure. They and `cofactors` are None without standard deviations.
    `options`: options of this adjustment; `adjust(block, result.options)` adjusts another block with them.

    It is a pytree, so it works with jit, grad and vmap.

    Example:
        >>> result
        <Adjustment quarry: converged, sigma0 0.9566, 4 images, 8 points>
        >>> result.points["E"].standard_deviations.shape
        (3,)
    """

    block: Block
    residuals: tuple[Float[Array, "_member _component"], ...]
    weighted_residuals: tuple[Float[Array, "_member _component"], ...]
    cofactors: BlockCofactors | None
    redundancy_numbers: tuple[Float[Array, "_member _component"], ...] | None
    iterations: Iterations
    options: Options
    reduced: str = eqx.field(static=True)  # solver of the reduced normal equations
    findings: tuple[Finding, ...] = eqx.field(static=True, default=())  # findings about the block and its adjustment
    reweighting: Reweighting | None = None  # None: not robust
    undetermined_directions: int = eqx.field(
        static=True, default=0
    )  # directions of the unknowns without effect on the residuals

    @property
    def _is_one(self) -> bool:
        """Whether its values are known, and those of one adjustment."""
        return is_concrete(self) and not np.ndim(self.iterations.status)

    def __repr__(self) -> str:
        structure = self.block.structure
        counts = f"{counted(len(structure.image_names), 'image')}, {counted(len(structure.point_names), 'point')}"
        how = f"{self.status.words}, sigma0 {float(self.sigma0):.4g}" if self._is_one else UNKNOWN
        return f"<Adjustment {structure.name or '(unnamed)'}: {how}, {counts}>"

    def _repr_html_(self) -> str:
        structure = self.block.structure
        title = f"Adjustment {structure.name or '(unnamed)'}"
        if not self._is_one:
            return result_html(title, [("status", UNKNOWN)], ())
        counts = counted(len(structure.image_names), "image"), counted(len(structure.point_names), "point")
        rows = [
            ("verdict", self.verdict),
            ("sigma0", f"{float(self.sigma0):.6g}"),
            ("block", ", ".join((*counts, counted(len(structure.ray_image), "ray")))),
            ("redundancy", f"{self.redundancy} = {self.n_observations} observations - {self.n_unknowns} unknowns"),
            ("datum", str(structure.datum)),
            ("iterations", f"{int(self.iterations.trials)}, {int(self.iterations.accepted)} accepted"),
        ]
        return result_html(title, rows, self.findings)

    @property
    def method(self) -> str:
        """The method of the adjustment."""
        return self.options.method

    @property
    def stopping_rule(self) -> str:
        """Name of the stopping rule."""
        return self.options.stop.name

    @property
    def weighted_block(self) -> Block:
        """The adjusted block with the final weights: those of the last robust round.

        `block` has the given sigmas. Computations with weights after an adjustment use this block instead.
        """
        if self.reweighting is None:
            return self.block
        return with_weights(self.block, np.asarray(self.block.rays.sigmas), np.asarray(self.reweighting.weights))

    @property
    def n_observations(self) -> int:
        """The number M of observations."""
        return self.block.n_observations

    @property
    def n_unknowns(self) -> int:
        """The number N of unknowns."""
        return self.block.structure.n_unknowns

    @property
    def redundancy(self) -> int:
        """Redundancy M - rank A: undetermined directions of the unknowns do not count in N."""
        return self.block.redundancy + self.undetermined_directions

    @property
    def vtpv(self) -> Float[Array, ""]:
        """The weighted sum of squares The weighted sum of squares v^T P v of all observations."""
        return _sum_of_squares(self.weighted_residuals)

    @property
    def sigma0(self) -> Float[Array, ""]:
        """A-posteriori standard deviation of unit weight, sqrt(v^T P v / (M - N))."""
        return _unit_weight(self.vtpv, self.redundancy)

    @property
    def status(self) -> Status:
        """The status of the iterations.

        Raises: ValueError under tracing, where values are unknown, and for the result of vmap.
        """
        status = self.iterations.status
        if not is_concrete(status):
            raise ValueError(
                "the status of an adjustment is unknown inside jit, grad and vmap: read it outside,"
                " or compare adjustment.iterations.status with jb.Status.CONVERGED by jnp.where"
            )
        if np.ndim(status):
            raise ValueError(f"these are {np.size(status)} adjustments of vmap: use adjustment.iterations.status")
        return Status(int(status))

    @property
    def trustworthy(self) -> bool:
        """Whether it converged and no finding forbids its use; raises as `status`."""
        return self.status is Status.CONVERGED and not self.failures

    @property
    def failures(self) -> tuple[Finding, ...]:
        """Findings that forbid the use of this result."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.FAILED)

    @property
    def verdict(self) -> str:
        """Verdict on the result in words: the status, and the reason if it must not be used."""
        return self._verdict(self.failures)

    def _verdict(self, failures: tuple[Finding, ...]) -> str:
        others = [finding for finding in failures if finding.kind is not Kind.NOT_CONVERGED]
        if not others:
            return self.status.words
        link = ", but its result" if self.status is Status.CONVERGED else "; its result"
        return f"{self.status.words}{link} must not be used: {others[0].kind.title}"

    @property
    def undetermined(self) -> tuple[Finding, ...]:
        """Findings about undetermined unknowns."""
        return of_kind(self.findings, Kind.PARTS, Kind.UNDETERMINED)

    @property
    def standard_deviations(self) -> StandardDeviations:
        """A-posteriori standard deviations of all unknowns.

        Raises: ValueError if they were not computed.
        """
        if self.cofactors is None:
            raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
        return self.cofactors.standard_deviations(self.sigma0)

    @property
    def points(self) -> Named[PointValues]:
        """The adjusted object points by name, with standard deviations and covariances if computed."""
        names, points = self.block.structure.point_names, self.block.object_points
        if self.cofactors is None:
            return self.block.points
        deviations, q = self.standard_deviations.object_points, self.cofactors.object_points
        variance = self.sigma0**2
        return Named("point", names, lambda k: PointValues(names[k], points[k], deviations[k], variance * q[k]))

    @property
    def images(self) -> Named[ImageValues]:
        """The adjusted orientations by name, with standard deviations and covariances if computed."""
        images = self.block.images
        if self.cofactors is None:
            return images
        sd, q, variance = self.standard_deviations, self.cofactors.exterior, self.sigma0**2
        names = self.block.structure.image_names

        def image(k: int) -> ImageValues:
            deviations = jnp.concatenate([sd.projection_centre[k], sd.angles[k]])
            return dataclasses.replace(images[names[k]], standard_deviations=deviations, covariance=variance * q[k])

        return Named("image", names, image)

    @property
    def cameras(self) -> Named[CameraValues]:
        """The adjusted cameras by name, with standard deviations of their elements if computed."""
        return self.block.cameras_with(None if self.cofactors is None else self.standard_deviations.interior)

    @property
    def success(self) -> bool:
        """Whether the result can be used (name as in `scipy.optimize`): converged, and no finding forbids it."""
        return self.trustworthy

    @property
    def message(self) -> str:
        """The verdict on the result in one sentence."""
        return self.verdict

    def to_frames(self, *, units: bool = True) -> dict[str, Any]:
        """Returns the results as polars frames by the names of the tables: images, cameras, points, rays and others.

        Args:
            units: Whether the names of columns have units, such as "X [m]" and "sd X [m]"; otherwise they are those of
                the CSV tables, such as "X" and "sX".

        Raises:
            ValueError: for a traced adjustment, or for sensors other than photographs.

        Example:
            result.to_frames()["points"]
        """
        return offered("frames_of")(self, units=units)

    @property
    def interior_correlations(self) -> Float[Array, "camera element element"]:
        """Correlations of the interior elements of each camera; 0 for fixed elements.

        Raises: ValueError if no cofactors were computed.
        """
        if self.cofactors is None:
            raise ValueError("this adjustment was made without standard deviations: call adjust(..., precision=True)")
        return self.cofactors.interior_correlations

    @property
    def check_differences(self) -> Float[Array, "check 3"]:
        """Adjusted - known coordinates of the check points; NaN where a coordinate is unknown."""
        adjusted, known = self.block.object_points, self.block.check_points.coordinates
        return _differences(adjusted, self.block.structure.check_point, known)

    def _reweighted(self) -> str:
        robust = self.reweighting
        assert robust is not None
        low = int((np.asarray(robust.weights) < DOWN_WEIGHTED).sum())
        return (
            f"Robust weights: {robust.name}, limit {robust.limit:g}, {robust.rounds} rounds"
            f"{'' if robust.settled else ', which did not converge'};"
            f" {counted(low, 'ray')} below {DOWN_WEIGHTED:g}"
        )

    def summary(self, found: tuple[Finding, ...] | None = None) -> str:
        """The result in a few lines, with the findings that forbid its use; the report has the rest.

        `found`: all findings of `findings`, if known; otherwise those of the adjustment.
        """
        structure, n = self.block.structure, self.iterations
        failures = self.failures if found is None else tuple(f for f in found if f.severity is Severity.FAILED)
        counts = (
            counted(len(structure.image_names), "image"),
            counted(len(structure.cameras), "camera"),
            counted(len(structure.point_names), "point"),
            counted(len(structure.ray_image), "ray"),
        )
        lines = [
            f"Block {structure.name or '(unnamed)'}: {', '.join(counts)}",
            f"The adjustment {self._verdict(failures)}"
            f" ({self.method}, {int(n.accepted)} steps of {int(n.trials)} tried,"
            f" stopping rule {self.stopping_rule}: {float(n.measure):.1e})",
            f"Observations {self.n_observations}, unknowns {self.n_unknowns}, redundancy {self.redundancy}",
            f"Datum: {structure.datum}",
            f"Reduced normal equations: {REDUCED[self.reduced]}",
            f"vTPv {float(n.initial_cost) * 2:.8g} -> {float(self.vtpv):.8g}, sigma0 {float(self.sigma0):.6g}",
            *([] if self.reweighting is None else [self._reweighted()]),
            *(f"Failed: {finding.words}" for finding in failures),
        ]
        return "\n".join(lines)


@on_host_or_traced
def _sum_of_squares(xp: Any, values: tuple) -> Any:
    return sum((xp.sum(v**2) for v in values), 0.0)


@on_host_or_traced
def _unit_weight(_xp: Any, vtpv: Any, redundancy: int) -> Any:
    return (vtpv / redundancy) ** 0.5


@on_host_or_traced
def _differences(_xp: Any, values: Any, which: np.ndarray, known: Any) -> Any:
    return values[which] - known


@on_host_or_traced
def _standard_deviations(_xp: Any, sigma0: Any, roots: list) -> tuple:
    exterior, *others = (sigma0 * root for root in roots)
    return exterior[:, :3], exterior[:, 3:], *others


@on_host_or_traced
def _correlations(xp: Any, cofactors: Any, roots: Any) -> Any:
    products = roots[:, :, None] * roots[:, None, :]
    return xp.where(products > 0, cofactors / xp.where(products > 0, products, 1.0), 0.0)


@on_host_or_traced
def _roots(xp: Any, cofactors: Any) -> Any:
    """Roots of the diagonals; the root of 0, for fixed elements, has the derivative 0."""
    diagonal = xp.diagonal(cofactors, axis1=-2, axis2=-1)
    return xp.where(diagonal == 0, 0.0, xp.sqrt(xp.where(diagonal == 0, 1.0, diagonal)))
