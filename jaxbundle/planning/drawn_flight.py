"""A random realisation of a flight: true orientations, true points, and the visible points of each image."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxbundle.planning.flight import FlightPlan
from jaxbundle.planning.ground import ground_points
from jaxbundle.planning.lines import Frame, Stations, frame_of, stations_of

NO_RESIDUAL = 1e-9  # share of the format; larger residuals remain only where the distortion has no inverse
ON_THE_EDGE = 1e-12  # share of the format: rounding of points of a schematic flight on the edge of an image


class Scene(NamedTuple):
    """True orientations and object points of a flight; control coordinates of sigma 0 are fixed."""

    stations: Stations
    centres: Float[np.ndarray, "image 3"]
    angles: Float[np.ndarray, "image 3"]
    points: Float[np.ndarray, "point 3"]
    control: Float[np.ndarray, "point 3"]
    """Sigmas of control coordinates, NaN if not observed."""
    listed_check: Bool[np.ndarray, " point"]

    @property
    def is_control(self) -> Bool[np.ndarray, " point"]:
        """Mask of the points with an observed or fixed coordinate."""
        return np.array(np.isfinite(self.control).any(1))


class Incidence(NamedTuple):
    """Pairs of images and visible points."""

    image: Int[np.ndarray, " ray"]
    point: Int[np.ndarray, " ray"]


def scene_of(plan: FlightPlan, rng: np.random.Generator) -> Scene:
    """Draws a flight: stations and angles with random deviations, points with the heights of the terrain."""
    frame = frame_of(plan)
    nominal = stations_of(plan, frame)
    xy = frame.to_object(nominal.xy)
    ground = float(plan.terrain.at(*xy.T).mean())
    centres = np.c_[xy, np.full(len(xy), ground + plan.height)]
    centres = centres + plan.scatter * plan.height * rng.standard_normal(centres.shape)
    angles = plan.tilt * rng.standard_normal(centres.shape)
    angles[:, 2] += nominal.kappa + frame.angle
    points = ground_points(plan, frame, nominal, rng)
    z = plan.terrain.at(*points.xy.T) + plan.terrain.relief * rng.uniform(-0.5, 0.5, len(points.xy))
    return Scene(nominal, centres, angles, np.c_[points.xy, z], points.sigmas, points.listed_check)


def near_pairs(plan: FlightPlan, scene: Scene) -> Incidence:
    """All candidate pairs of image and point: the point is in an enlarged footprint of the image."""
    frame: Frame = frame_of(plan)
    margin = 4 * (plan.tilt + plan.scatter)
    ground = scene.centres[:, 2].mean() - plan.height
    depth = np.abs(scene.points[:, 2] - ground).max(initial=0.0) / plan.height
    reach = (0.5 + depth + margin) * np.array(frame.footprint) + (margin + 1e-6) * plan.height
    tree = KDTree(scene.points[:, :2])
    found = tree.query_ball_point(scene.centres[:, :2], math.hypot(*reach))
    image = np.repeat(np.arange(len(found)), [len(f) for f in found])
    point = np.concatenate([np.asarray(f, int) for f in found])
    kappa = (scene.stations.kappa + frame.angle)[image]
    off = scene.points[point, :2] - scene.centres[image, :2]
    c, s = np.cos(kappa), np.sin(kappa)
    inside = (np.abs(c * off[:, 0] + s * off[:, 1]) <= reach[0]) & (np.abs(c * off[:, 1] - s * off[:, 0]) <= reach[1])
    image, point = image[inside], point[inside]
    order = np.lexsort((point, image))
    return Incidence(image[order].astype(np.int32), point[order].astype(np.int32))


def shown(
    plan: FlightPlan,
    scene: Scene,
    near: Incidence,
    coordinates: Float[np.ndarray, "near 2"],
    left: Float[np.ndarray, "near 2"],
) -> tuple[Scene, Incidence, Float[np.ndarray, "ray 2"]]:
    """The visible points: points on at least two images, control points on one; the others are left out.

    `coordinates` and `left`: image coordinates of all candidate pairs and their remaining residuals.
    """
    camera = plan.camera
    half = np.array([camera.width, camera.height]) / 2 / (camera.pixel_size or 1.0)
    inside = (np.abs(coordinates - camera.centre) <= half * (1 + ON_THE_EDGE)) & (np.abs(left) <= NO_RESIDUAL * half)
    ray = inside.all(1)
    rays = np.bincount(near.point[ray], minlength=len(scene.points))
    kept = rays >= np.where(scene.is_control, 1, 2)
    ray &= kept[near.point]
    number = np.cumsum(kept, dtype=np.int32) - 1
    scene = scene._replace(
        points=scene.points[kept], control=scene.control[kept], listed_check=scene.listed_check[kept]
    )
    return scene, Incidence(near.image[ray], number[near.point[ray]]), coordinates[ray]
