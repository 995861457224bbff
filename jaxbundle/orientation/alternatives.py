"""Undoing common confusions: the block with x and y exchanged, kappa rotated, Z0 negative and so on.

If the rays agree with their points far better under an alternative, this alternative is the probable confusion.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxbundle.geometry.rotation import ROTATION_SYSTEMS, RotationSystem
from jaxbundle.numerics.host import on_host
from jaxbundle.orientation.sight import Sight, medians, mostly_beyond, relative_off

PLAIN = 0.3  # image fields: below this, approximate orientations are rough, not confused
EXPLAINED = 0.2  # maximum share of the angles that an alternative may leave
MIRRORED = (
    ("y", np.array([[1.0, 0.0], [0.0, -1.0]])),
    ("x", np.array([[-1.0, 0.0], [0.0, 1.0]])),
    ("x and y", np.array([[0.0, 1.0], [1.0, 0.0]])),
    ("x and y, both negative", np.array([[0.0, -1.0], [-1.0, 0.0]])),
)
TURNS = (180.0, 90.0, -90.0)  # deg


class Alternative(NamedTuple):
    """An alternative to the input values.

    `words`:

    its description. `of`: "rays", "attitudes", "stations", "object" or "both". `component`: of the image or ray.
    `usual`: a frequent mistake; others are accepted only if no usual one is an equally good explanation.
    """

    words: str
    of: str
    component: str
    sight: Sight
    usual: bool = True


class Given(NamedTuple):
    """The input values: rays, angles in radians, rotation system and the user's unit of angles."""

    sight: Sight
    angles: Float[np.ndarray, "image 3"]
    system: RotationSystem
    unit: str


def of_rays(sight: Sight) -> list[Alternative]:
    """Alternatives with mirrored image coordinates, which no attitude can compensate."""
    words = {
        "y": "y upside down",
        "x": "x mirrored",
        "x and y": "x and y exchanged",
        "x and y, both negative": "x and y exchanged and both mirrored",
    }
    return [
        Alternative(words[name], "rays", name, sight._replace(plane=sight.plane @ matrix.T))
        for name, matrix in MIRRORED
    ]


def of_object(sight: Sight) -> list[Alternative]:
    """The alternative with easting and northing exchanged everywhere: a left-handed system."""
    exchange = [1, 0, 2]
    moved = sight._replace(
        centre=sight.centre[:, exchange], points=sight.points[:, exchange], known=sight.known[:, exchange]
    )
    return [Alternative("X and Y of all coordinates exchanged", "object", "X", moved)]


def of_attitudes(given: Given) -> list[Alternative]:
    """Alternatives with rotated or exchanged angles, other units, or another matrix."""
    first, middle, last = given.system.angles
    turned = {
        f"{last} off by {turn:g} deg": (given.angles + np.array([0.0, 0.0, np.radians(turn)]), last) for turn in TURNS
    }
    others = {
        f"{last} of opposite sign": (given.angles * [1, 1, -1], last),
        f"{first} and {middle} exchanged": (given.angles[:, [1, 0, 2]], first),
        **{f"angles in {unit}": (given.angles * factor, "") for unit, factor in _units(given.unit).items()},
    }
    alternatives = [
        Alternative(words, "attitudes", component, _attitudes(given.sight, given.system, angles))
        for words, (angles, component) in {**turned, **others}.items()
    ]
    opposite = _attitudes(given.sight, given.system, -given.angles)
    alternatives.append(Alternative("all angles of opposite sign", "attitudes", "", opposite, False))
    transposed = given.sight._replace(rotation=given.sight.rotation.transpose(0, 2, 1))
    alternatives.append(Alternative("the transposed rotation matrix", "attitudes", "", transposed, False))
    for system in ROTATION_SYSTEMS.values():
        if system is not given.system:
            sight = _attitudes(given.sight, system, given.angles)
            alternatives.append(Alternative(f"angles of the system {system.name}", "attitudes", "", sight, False))
    half_turn = given.sight._replace(rotation=given.sight.rotation * [1.0, -1.0, -1.0])
    alternatives.append(Alternative("the cameras looking the other way", "attitudes", first, half_turn))
    return alternatives


def of_both(sight: Sight) -> list[Alternative]:
    """Alternatives that satisfy the image equation equally well, with all points behind the cameras."""
    upside_down = sight._replace(
        centre=_above_ground(sight), rotation=sight.rotation * np.array([-1.0, -1.0, 1.0])[None, :, None]
    )
    inverted = sight._replace(centre=-sight.centre, points=-sight.points, known=-sight.known)
    return [
        Alternative("stations and attitudes mirrored in the ground", "both", "Z0", upside_down),
        Alternative("the opposite sign of all coordinates of stations and points", "both", "", inverted),
    ]


def _above_ground(sight: Sight) -> Float[np.ndarray, "image 3"]:
    """Projection centres mirrored at the mean height of the points."""
    finite = np.isfinite(sight.believed).all(1)
    ground = np.median(sight.believed[finite, 2]) if finite.any() else 0.0
    return np.c_[sight.centre[:, :2], 2 * ground - sight.centre[:, 2]]


def of_stations(sight: Sight) -> list[Alternative]:
    """Alternatives with positions of opposite sign or exchanged."""
    height = np.array([1.0, 1.0, -1.0])
    mirrored = _above_ground(sight)
    return [
        Alternative("Z0 of opposite sign", "stations", "Z0", sight._replace(centre=sight.centre * height)),
        Alternative("the stations above the ground", "stations", "Z0", sight._replace(centre=mirrored)),
        Alternative("X0 and Y0 exchanged", "stations", "X0", sight._replace(centre=sight.centre[:, [1, 0, 2]])),
    ]


def _units(unit: str) -> dict[str, float]:
    """Factors for angles that were read in one unit but are given in another one."""
    per_turn = {"deg": 360.0, "gon": 400.0, "rad": 2 * np.pi}
    return {other: per_turn[unit] / turn for other, turn in per_turn.items() if other != unit}


def _attitudes(sight: Sight, system: RotationSystem, angles: Float[np.ndarray, "image 3"]) -> Sight:
    rotation = np.stack([on_host(x) for x in system.rotation_from_angles(*angles.T)], -1)
    return sight._replace(rotation=rotation.reshape(-1, 3, 3))


def left(sight: Sight) -> Float[np.ndarray, " image"]:
    """Median angle between rays and points of each image, in image fields."""
    points = sight.believed
    usable = sight.is_believed[sight.point]
    return medians(relative_off(sight, points)[usable], sight.image[usable], len(sight.centre))


def mirrored(sight: Sight) -> Alternative | None:
    """The mirrored image coordinates or object system with which the most images agree with their points."""
    usable = sight.is_believed[sight.point]
    doubtful = mostly_beyond(relative_off(sight, sight.believed)[usable], PLAIN, sight.image[usable], len(sight.centre))
    if 2 * doubtful.sum() <= len(np.unique(sight.image[usable])):
        return None
    now = left(sight)
    best, most = None, 0.5 * np.isfinite(now).sum()
    for alternative in (*of_rays(sight), *of_object(sight)):
        explained = (explains(left(alternative.sight), now)).sum()
        if explained > most:
            best, most = alternative, explained
    return best


def explains(alternative: Float[np.ndarray, " image"], now: Float[np.ndarray, " image"]) -> np.ndarray:
    """Mask of the images that agree with their points far better under an alternative."""
    return (alternative <= EXPLAINED * now) & (alternative <= EXPLAINED)
