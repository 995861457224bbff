"""Observations other than image points (group III of Text 001).

A kind of observation is one differentiable function of the touched unknowns and of the observed values,

    residual(touched_1, touched_2, ..., observed) -> (v_1, ..., v_k),        v = computed - observed

written for one member, with scalar arguments and scalar results; autodiff computes its rows of the design matrix. A
kind with constants (a time, a reference point) receives them as an additional last argument. The argument of a touched
entity is

    "point"      (X, Y, Z)
    "image"      (projection centre (X0, Y0, Z0), rotation (a1 ... c3))
    "camera"     (interior element, ...) in the order of the camera's model
    "parameter"  one scalar: an additional unknown, such as a shift of the navigation data

The rest of the package does not depend on the list of kinds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.camera.collinearity import Vector
from jaxbundle.geometry.rotation import Rotation, Scalar
from jaxbundle.numerics.host import freeze_arrays, on_device, on_host_or_traced
from jaxbundle.numerics.trial import defect


@dataclass(frozen=True)
class ObservationKind:
    """A kind of observation.

    `name` is unique; `in_object_system`: observed values are object coordinates, which a shift of the origin changes.

    `constants`: names of additional numbers of each member; X, Y, Z are object coordinates. `angles`: whether its
    components are angles, here in radians, in reports in the angle unit of the block. `table`: the table of a block
    folder with its rows, if its name differs from that of the kind.

    Example:
        >>> def height(touched, constants):
        ...     (point,) = touched
        ...     return (point[2],)
        >>> kind = jb.observations.ObservationKind("heights", ("Z",), ("point",), height)
        >>> kind.components
        ('Z',)
    """

    name: str
    components: tuple[str, ...]
    touches: tuple[str, ...]
    residual: Callable[..., tuple[Scalar, ...]]
    in_object_system: bool = False
    constants: tuple[str, ...] = ()
    angles: bool = False
    table: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.table, str) and not self.table:
            object.__setattr__(self, "table", self.name)

    def residuals(self, touched: tuple, observed: tuple[Scalar, ...], constants: tuple[Scalar, ...]) -> tuple:
        """The residuals of a member, or of many members if the scalars are arrays."""
        return self.residual(*touched, observed, constants) if self.constants else self.residual(*touched, observed)


def kind_defect(kind: ObservationKind, elements: int) -> str:
    """The problem of an invalid kind, as the end of a sentence; "" for a valid one. A kind is tried once.

    `elements`: number of interior elements of a camera.
    """
    if not callable(kind.residual):
        return f"is of type {type(kind.residual).__name__}, not a function"
    try:
        return _tried(kind, elements)
    except TypeError:  # static arguments of a program must have a hash
        return "cannot be hashed: its names are not tuples, or it is an object that contains arrays or lists"


@cache
def _tried(kind: ObservationKind, elements: int) -> str:
    touched = {
        "point": (0.0,) * 3,
        "image": ((0.0,) * 3, (0.0,) * 9),
        "camera": (0.0,) * elements,
        "parameter": 0.0,
    }
    arguments = [touched[entity] for entity in kind.touches]
    constants = [(0.0,) * len(kind.constants)] if kind.constants else []
    return defect(kind.residual, (*arguments, (0.0,) * len(kind.components), *constants), len(kind.components))


@dataclass(frozen=True, eq=False)
class GroupStructure:
    """The static part of a group: touched entities and observed components of each member.

    Compared by identity, because it is static under jit; therefore its arrays are read-only.
    """

    kind: ObservationKind
    indices: Int[np.ndarray, "member touched"]
    observed: Bool[np.ndarray, "member component"]

    def __post_init__(self) -> None:
        freeze_arrays(self)


class ObservationGroup(eqx.Module):
    """All observations of one kind: structure (static) and values.

    Components that are not observed have sigma 1 and weight 0.

    `covariances`: matrix of the components of each member, which replaces `sigmas`; None without correlations.

    Example:
        >>> group = block.groups[0]
        >>> group.structure.kind.name, group.values.shape
        ('control', (4, 3))
    """

    structure: GroupStructure = eqx.field(static=True)
    values: Float[Array, "member component"]
    sigmas: Float[Array, "member component"]
    constants: Float[Array, "member constant"]
    covariances: Float[Array, "member component component"] | None = None

    @property
    def weights(self) -> Float[Array, "member component *component"]:
        """Square roots of the weights: 1/sigma, or L^-1 for covariances L L^T; 0 where not observed."""
        return _weights(self.structure.observed, self.sigmas, self.covariances)

    def unweighted(self, weighted: Float[Array, "member component"]) -> Float[Array, "member component"]:
        """Residuals from weighted residuals (times the square roots of the weights); 0 where not observed."""
        matrices = None if self.covariances is None else self.weights
        return _unweighted(self.structure.observed, weighted, self.sigmas, matrices)

    @property
    def count(self) -> int:
        """Number of observed components."""
        return int(self.structure.observed.sum())


@on_host_or_traced
def _weights(xp: Any, observed: Any, sigmas: Any, covariances: Any) -> Any:
    if covariances is None:
        return xp.divide(observed.astype(float), sigmas)
    both = observed[:, :, None] & observed[:, None, :]
    size = observed.shape[1]
    factor = xp.linalg.cholesky(xp.where(both, covariances, np.eye(size)))
    return xp.where(both, xp.linalg.solve(factor, np.broadcast_to(np.eye(size), factor.shape)), 0.0)


@on_host_or_traced
def _unweighted(xp: Any, observed: Any, weighted: Any, sigmas: Any, matrices: Any) -> Any:
    """`matrices`: the square roots of the weights of correlated components."""
    if matrices is None:
        return xp.multiply(weighted, sigmas)
    missing = np.eye(weighted.shape[1]) * ~observed[:, None, :]
    return xp.linalg.solve(xp.add(matrices, missing), xp.expand_dims(weighted, 2))[..., 0]


def _coordinates(point: Vector, observed: Vector) -> Vector:
    return point[0] - observed[0], point[1] - observed[1], point[2] - observed[2]


def _projection_centre(image: tuple[Vector, Rotation], observed: Vector) -> Vector:
    return _coordinates(image[0], observed)


def _parameter(parameter: Scalar, observed: tuple[Scalar]) -> tuple[Scalar]:
    return (parameter - observed[0],)


def _interior(camera: tuple[Scalar, ...], observed: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    return tuple(element - value for element, value in zip(camera, observed, strict=False))  # a mixture has one more


CONTROL = ObservationKind("control", ("X", "Y", "Z"), ("point",), _coordinates, in_object_system=True)
"""Observed coordinates of object points.

Example:
    >>> jb.observations.CONTROL.components, jb.observations.CONTROL.touches
    (('X', 'Y', 'Z'), ('point',))
"""
STATIONS = ObservationKind("stations", ("X0", "Y0", "Z0"), ("image",), _projection_centre, in_object_system=True)
"""Observed projection centres.

Example:
    >>> jb.observations.STATIONS.components
    ('X0', 'Y0', 'Z0')
"""
PARAMETERS = ObservationKind("parameters", ("value",), ("parameter",), _parameter)
"""Observed values of parameters of a block.

Example:
    >>> jb.observations.PARAMETERS.touches
    ('parameter',)
"""


def interior_priors(elements: tuple[str, ...]) -> ObservationKind:
    """The kind of observed interior elements, for cameras with these elements or with their number.

    Example:
        >>> jb.observations.interior_priors(("principal_distance", "x0", "y0")).components
        ('principal_distance', 'x0', 'y0')
    """
    return ObservationKind("interior", elements, ("camera",), _interior)


def observation_group(
    kind: ObservationKind,
    indices: Int[np.ndarray, "member touched"],
    values: Float[np.ndarray, "member component"],
    sigmas: Float[np.ndarray, "member component"],
    constants: Float[np.ndarray, "member constant"] | None = None,
    covariances: Float[np.ndarray, "member component component"] | None = None,
) -> ObservationGroup:
    """Makes a group from arrays; NaN marks a component that is not observed.

    Example:
        >>> group = jb.observations.observation_group(
        ...     jb.observations.DISTANCES, np.array([[0, 1]]), np.array([[87.4]]), np.array([[0.01]])
        ... )
        >>> group.values.shape
        (1, 1)
    """
    observed = np.isfinite(values) & np.isfinite(sigmas)
    structure = GroupStructure(kind, np.asarray(indices, np.int32), observed)
    constants = np.zeros((len(values), 0)) if constants is None else constants
    values, sigmas = np.where(observed, values, 0.0), np.where(observed, sigmas, 1.0)
    return ObservationGroup(structure, *on_device((values, sigmas, constants, covariances)))
