"""Preparing a block for writers of foreign formats: cameras in px with v down, names, and contents that are lost.

A camera that a format can represent is written exactly. For any other the corrected measurement is written with a
camera without distortion, u' = computed without distortion - v, so that all residuals of the block are unchanged:

    none             f = c / s
    brown-forward    f = c / s, K1 c^2, K2 c^4, K3 c^6, P1 c, -P2 c      coefficients of c = 1, v down
    bal              f, k1, k2, y down, principal point in the middle of the image
    all others       corrected measurements, unless the format has the same model
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.block.block import Block
from jaxbundle.block.observation_kinds import CONTROL, STATIONS
from jaxbundle.block.wording import counted
from jaxbundle.camera.brown import DISTORTION_FREE
from jaxbundle.camera.forward import BAL, BROWN_FORWARD, METASHAPE
from jaxbundle.camera.lenses import DIVISION, EUCM, FISHEYE, FISHEYE_624, FOV, RATIONAL
from jaxbundle.io.formats import rotations
from jaxbundle.io.formats.foreign_block import (
    Distance,
    ForeignBlock,
    ForeignCamera,
    Images,
    Known,
    Points,
    RayTable,
    element,
    triple,
)
from jaxbundle.io.formats.misfit import ray_residuals
from jaxbundle.numerics.host import on_host

NOMINAL_PIXEL = 0.005  # mm, for a camera in mm with unknown pixel size: any size gives the same block
MARGIN = 1.02  # factor of the extent of the rays: the format where it is unknown
LENSES = (METASHAPE, RATIONAL, FISHEYE, FISHEYE_624, FOV, DIVISION, EUCM)  # in px, v down, elements of c = 1


class Written(NamedTuple):
    """A block in px, and sentences about what the format changes or cannot represent."""

    foreign: ForeignBlock
    losses: tuple[str, ...]


def foreign_block(block: Block) -> ForeignBlock:
    """The block with its own cameras; control with its sigmas, 0 for fixed coordinates."""
    s, values = block.structure, on_host(block.interior.elements)
    cameras = tuple(
        ForeignCamera(
            camera.name,
            camera.model,
            dict(zip(camera.model.elements, values[k].tolist(), strict=False)),
            tuple(name for name, free in zip(camera.model.elements, s.interior_free[k], strict=False) if free),
            camera.image_unit,
            camera.width,
            camera.height,
        )
        for k, camera in enumerate(s.cameras)
    )
    angles = on_host(block.exterior.angles)
    matrices = rotations.matrices(s.rotation_system.rotation_from_angles, angles)
    rays = RayTable(
        s.ray_image.astype(np.int64),
        s.ray_point.astype(np.int64),
        on_host(block.rays.coordinates),
        on_host(block.rays.sigmas).mean(1),
    )
    return ForeignBlock(
        "block",
        s.name or "block",
        cameras,
        Images(s.image_names, s.image_camera.astype(np.int64), matrices, on_host(block.exterior.projection_centre)),
        Points(s.point_names, on_host(block.object_points)),
        rays,
        control=_control(block),
        stations=_observed(block, STATIONS.name, s.image_names),
        distances=_distances(block),
        coordinate_system=s.source.partition("coordinate system: ")[2],
    )


def _observed(block: Block, kind: str, names: tuple[str, ...]) -> tuple[Known, ...]:
    rows = []
    for group in (group for group in block.groups if group.structure.kind.name == kind):
        values = np.where(group.structure.observed, on_host(group.values), np.nan).tolist()
        sigmas = np.where(group.structure.observed, on_host(group.sigmas), np.nan).tolist()
        index = group.structure.indices[:, 0].tolist()
        rows += [Known(names[i], triple(v), triple(q)) for i, v, q in zip(index, values, sigmas, strict=True)]
    return tuple(rows)


def _control(block: Block) -> tuple[Known, ...]:
    s, points = block.structure, on_host(block.object_points)
    rows = {row.name: row for row in _observed(block, CONTROL.name, s.point_names)}
    nowhere = (np.nan, np.nan, np.nan)
    for k in np.flatnonzero(~s.point_free.all(1)).tolist():
        name, held = s.point_names[k], ~s.point_free[k]
        old = rows.get(name, Known(name, nowhere, nowhere))
        place, sigma = np.where(held, points[k], old.coordinates), np.where(held, 0.0, old.sigmas)
        rows[name] = Known(name, triple(place), triple(sigma))
    check, sigmas = on_host(block.check_points.coordinates).tolist(), on_host(block.check_points.sigmas).tolist()
    for k, place, sigma in zip(s.check_point.tolist(), check, sigmas, strict=True):
        rows[s.point_names[k]] = Known(s.point_names[k], triple(place), triple(sigma), True)
    return tuple(rows.values())


def _distances(block: Block) -> tuple[Distance, ...]:
    names, rows = block.structure.point_names, []
    for group in block.groups:
        if group.structure.kind.name == "distances" and group.structure.kind.touches == ("point", "point"):
            both = zip(group.structure.indices, on_host(group.values), on_host(group.sigmas), strict=True)
            rows += [Distance(names[a], names[b], float(v[0]), float(q[0])) for (a, b), v, q in both]
    return tuple(rows)


def in_pixels(block: Block, holds: Callable[[ForeignCamera], bool]) -> Written:
    """The block with cameras in px that a format can represent; `holds`: whether it can do so for one of `LENSES`."""
    foreign = foreign_block(block)
    v, _ = ray_residuals(foreign)
    camera_of_ray = foreign.images.camera[foreign.rays.image]
    cameras, xy, losses = list(foreign.cameras), foreign.rays.xy.copy(), []
    for k, camera in enumerate(foreign.cameras):
        own = np.flatnonzero(camera_of_ray == k)
        exact, turned = _exact(camera, xy[own])
        if exact is not None and holds(exact):
            cameras[k], xy[own] = exact, turned
            continue
        cameras[k], xy[own] = _corrected(foreign, k, own, v[own])
        losses.append(
            f"camera {camera.name}: the format cannot represent the model {camera.model.name}; the image"
            " coordinates are written corrected, with a camera without distortion"
        )
    for camera in foreign.cameras:
        if camera.image_unit == "mm":
            losses.append(f"camera {camera.name}: mm are written as px of {NOMINAL_PIXEL} mm")
    table = RayTable(foreign.rays.image, foreign.rays.point, xy, foreign.rays.sigma)
    return Written(dataclasses.replace(foreign, cameras=tuple(cameras), rays=table), tuple(losses))


def _format(camera: ForeignCamera, half: float, xy: Float[np.ndarray, "ray 2"]) -> tuple[int, int]:
    """Width and height in px; without them, from the extent of the rays. `half`: px per unit of the rays."""
    if camera.width and camera.height:
        return camera.width, camera.height
    if camera.image_unit == "px" and camera.model is not BAL:
        extent = np.maximum(MARGIN * xy.max(0), 1.0) if len(xy) else np.ones(2)
        middle = 2 * np.array([element(camera, "x0"), element(camera, "y0")])
        extent = np.maximum(extent, middle)
    else:
        extent = 2 * MARGIN * half * np.abs(xy).max(0) if len(xy) else np.ones(2)
    width, height = np.ceil(np.maximum(extent, 1.0)).astype(int).tolist()
    return width, height


def _exact(
    camera: ForeignCamera, xy: Float[np.ndarray, "ray 2"]
) -> tuple[ForeignCamera | None, Float[np.ndarray, "ray 2"]]:
    """The camera as one of `LENSES` with its rays in px, v down; None where its model is not one of them."""
    in_px = camera.image_unit == "px" and camera.model is not BAL
    scale = 1.0 if in_px or camera.model is BAL else 1 / NOMINAL_PIXEL
    width, height = _format(camera, scale, xy)
    given = {name: element(camera, name) for name in camera.model.elements}
    middle = np.array([width / 2, height / 2])
    point = np.array([given.get("x0", 0.0), given.get("y0", 0.0)])
    turned = xy
    if not in_px:
        turned, point = middle + xy * [scale, -scale], middle + point * [scale, -scale]
    elements = _elements(camera, given, scale)
    if elements is None:
        return None, turned
    elements |= {"x0": float(point[0]), "y0": float(point[1])}
    model = camera.model if camera.model in LENSES else METASHAPE
    estimate = tuple(name for name in camera.estimate if name in model.elements)
    return ForeignCamera(camera.name, model, elements, estimate, "px", width, height), turned


def _elements(camera: ForeignCamera, given: dict[str, float], scale: float) -> dict[str, float] | None:
    """Elements of a lens with c = 1; None where the model has no such form."""
    c, s = given["principal_distance"], given.get("pixel_size", 1.0)
    if camera.model in LENSES:
        return dict(given)
    if camera.model is BAL:
        return {"principal_distance": c, "K1": given["k1"], "K2": given["k2"]}
    free = {"principal_distance": c / s * (scale if camera.image_unit == "mm" else 1.0)}
    if camera.model is DISTORTION_FREE or camera.model.elements[3:5] == ("pixel_size", "y_axis"):
        return free if camera.model is DISTORTION_FREE else None
    if camera.model is BROWN_FORWARD:
        radial = {f"K{n}": given[f"K{n}"] * c ** (2 * n) for n in (1, 2, 3)}
        return free | radial | {"P1": given["P1"] * c, "P2": -given["P2"] * c}
    corrections = [name for name in given if name not in ("principal_distance", "x0", "y0", "pixel_size", "y_axis")]
    without = all(given[name] == 0 for name in corrections if name not in ("grid_base", "R0"))
    return free if without else None


def _corrected(
    foreign: ForeignBlock, k: int, own: np.ndarray, v: Float[np.ndarray, "ray 2"]
) -> tuple[ForeignCamera, Float[np.ndarray, "ray 2"]]:
    """A camera without distortion and the corrected measurements of its rays: computed - v, v down."""
    camera = foreign.cameras[k]
    metric = camera.image_unit == "mm"
    scale = 1 / NOMINAL_PIXEL if metric else 1.0
    width, height = _format(camera, scale, foreign.rays.xy[own])
    given = {name: element(camera, name) for name in camera.model.elements}
    point = np.array([given.get("x0", 0.0), given.get("y0", 0.0)])
    if metric or camera.model is BAL:
        point = np.array([width / 2, height / 2]) + point * [scale, -scale]
    f = given["principal_distance"] / given.get("pixel_size", 1.0) * (scale if metric else 1.0)
    elements = {"principal_distance": f, "x0": float(point[0]), "y0": float(point[1])}
    free = ForeignCamera(camera.name, METASHAPE, elements, ("principal_distance",), "px", width, height)
    one = dataclasses.replace(
        foreign,
        cameras=(free,),
        images=foreign.images._replace(camera=np.zeros(len(foreign.images.names), np.int64)),
        rays=RayTable(foreign.rays.image[own], foreign.rays.point[own], np.zeros((len(own), 2))),
    )
    computed, _ = ray_residuals(one)  # residual of a measurement 0: the computed coordinates, y up
    return free, computed * [1, -1] - v * [scale, -scale]


def is_free(camera: ForeignCamera) -> bool:
    """Whether a camera of `LENSES` has no distortion."""
    others = set(camera.model.elements) - {"principal_distance", "x0", "y0", "y_axis"}
    return camera.model is METASHAPE and not any(element(camera, name) for name in others)


def losses_of_block(block: Block, holds: frozenset[str]) -> list[str]:
    """Contents of a block that a format cannot represent; `holds`: supported tables, and "sigmas"."""
    s, losses = block.structure, []
    for group in block.groups:
        if group.structure.kind.table not in holds:
            losses.append(f"{counted(len(group.structure.indices), 'row')} of {group.structure.kind.table}")
    if "control" not in holds and not s.point_free.all():
        held = int((~s.point_free.all(1)).sum())
        losses.append(f"that {counted(held, 'control point')} {'is' if held == 1 else 'are'} fixed")
    if "control" not in holds and len(s.check_point):
        losses.append(f"{counted(len(s.check_point), 'check point')}")
    if "sigmas" not in holds and np.ptp(on_host(block.rays.sigmas)) > 0:
        losses.append("the individual standard deviations of image coordinates")
    if s.datum.kind in ("fixed", "inner") or s.datum.held:
        losses.append("the datum")
    return losses
