"""Converting observations and fixed values of photographs to the points and models that represent them.

The projection centre of a photograph is a separate object point. The rotation of a photograph is that of one of its
models times its constant rotation within the model.
"""

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.findings import Finding, Kind, Subject
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, GroupStructure, ObservationGroup, ObservationKind
from jaxbundle.block.wording import counted, named
from jaxbundle.geometry import rotation
from jaxbundle.geometry.rotation import Scalar
from jaxbundle.numerics.host import on_device

ROTATION = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))


class Stand(NamedTuple):
    """Representation of points and images of the photographs; -1 for unused ones."""

    point: Int[np.ndarray, " point"]
    """Index of each point among the new points."""
    centre: Int[np.ndarray, " image"]
    """Index of the new point at the projection centre."""
    sensor: Int[np.ndarray, " image"]
    """Index of a model or strip with the image."""
    rotation: Float[np.ndarray, "image 3 3"]
    """Matrix sensor_from_image."""


@dataclass(frozen=True)
class _Residual:
    """The residual of a kind that touches sensors; a class, so that its fields identify compiled programs."""

    kind: ObservationKind

    def __call__(self, *arguments: Any) -> tuple[Scalar, ...]:
        *touched, observed, constants = arguments
        given, images, at = iter(touched), [], len(self.kind.constants)
        for entity in self.kind.touches:
            one = next(given)
            if entity == "image":
                one, at = (next(given), rotation.product(one[1], constants[at : at + 9])), at + 9
            images.append(one)
        return self.kind.residuals(tuple(images), observed, constants[: len(self.kind.constants)])


@cache
def kind_of_sensors(kind: ObservationKind) -> ObservationKind:
    """Converts a kind: sensor and projection centre replace a touched image.

    The rotations of the images within their sensors are additional constants.
    """
    touches: list[str] = []
    for entity in kind.touches:
        touches += ["image", "point"] if entity == "image" else [entity]
    names = tuple(f"{name}_{k + 1}" for k in range(kind.touches.count("image")) for name in ROTATION)
    constants = (*kind.constants, *names)
    return dataclasses.replace(kind, touches=tuple(touches), residual=_Residual(kind), constants=constants)


def translated(
    groups: tuple[ObservationGroup, ...], names: dict[str, tuple[str, ...]], stand: Stand
) -> tuple[tuple[ObservationGroup, ...], tuple[Finding, ...]]:
    """The groups for models or strips, and findings about unused observations.

    `names`: of the points and images of the photographs.
    """
    found, told = [], []
    for group in groups:
        kind = group.structure.kind
        if "camera" in kind.touches:
            told.append(
                Finding(
                    Kind.UNUSED,
                    f"{counted(group.count, 'observation')} of interior elements are not used: models are formed with"
                    " fixed interior elements",
                    "estimate interior elements by the bundle method",
                    (Subject(kind.table),),
                )
            )
            continue
        indices = _indices(group, stand)
        takes_part = np.asarray((indices >= 0).all(1))
        if not takes_part.all():
            told.append(_unused(group, ~takes_part, names))
        if takes_part.any():
            found.append(_translated(group, indices, takes_part, stand))
    return tuple(found), tuple(told)


def _indices(group: ObservationGroup, stand: Stand) -> Int[np.ndarray, "member touched"]:
    kind, columns = group.structure.kind, []
    for entity, index in zip(kind.touches, group.structure.indices.T, strict=True):
        if entity == "image":
            columns += [stand.centre[index]] if kind is STATIONS else [stand.sensor[index], stand.centre[index]]
        else:
            columns.append(stand.point[index] if entity == "point" else index)
    return np.stack(columns, 1).astype(np.int32)


def _translated(
    group: ObservationGroup, indices: Int[np.ndarray, "member touched"], part: np.ndarray, stand: Stand
) -> ObservationGroup:
    kind, structure = group.structure.kind, group.structure
    constants = [np.asarray(group.constants)]
    if kind is STATIONS:
        kind = CONTROL
    elif "image" in kind.touches:
        for entity, index in zip(kind.touches, structure.indices.T, strict=True):
            if entity == "image":
                constants.append(stand.rotation[index].reshape(-1, 9))
        kind = kind_of_sensors(kind)
    covariances = None if group.covariances is None else on_device(np.asarray(group.covariances)[part])
    return ObservationGroup(
        GroupStructure(kind, indices[part], structure.observed[part]),
        on_device(np.asarray(group.values)[part]),
        on_device(np.asarray(group.sigmas)[part]),
        on_device(np.concatenate(constants, 1)[part]),
        covariances,
    )


def _unused(group: ObservationGroup, missing: np.ndarray, names: dict[str, tuple[str, ...]]) -> Finding:
    """The finding about members whose point or image is in no model."""
    entity = next(e for e in group.structure.kind.touches if e in names)
    column = group.structure.kind.touches.index(entity)
    who = [names[entity][i] for i in group.structure.indices[missing, column].tolist()]
    table = group.structure.kind.table
    return Finding(
        Kind.UNUSED,
        f"{counted(len(who), 'row')} of {table} are not used, because {named(who)} {'is' if len(who) == 1 else 'are'}"
        " in no model",
        "adjust them by the bundle method, or measure the points in both images of a model",
        tuple(Subject(table, (name,)) for name in who),
    )
