"""Targets and aerial photographs measured against published values: python tests/benchmarks/targets.py [FOLDERS]

1. The discs of a calibration sheet (../shared/data/camcal-c1-fixed, -selfcal-3) matched with a drawn disc: sigma0 of
   the adjustment with the published marks and with these.
2. Painted crosses (../shared/data/images/copr) matched with a drawn cross: differences to marks set by hand.
3. Points of aerial photographs matched on level 3: their y-parallaxes in the adjusted orientation of
   ../shared/data/strasbourg-s4-tie.

The test data have one photograph each of the last two; `--copr` and `--strasbourg` name folders with all of them
(github.com/OpenDroneMap/odm_data_copr, github.com/niclasborlin/dbat). Needs `pip install -e .[measure]`.
"""

import argparse
import sys
from itertools import combinations
from pathlib import Path

from jaxbundle.cli import runtime

runtime.start()
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np  # noqa: E402
from cases.targets import discs  # noqa: E402
from cases.textures import grey_image  # noqa: E402

import jaxbundle as jb  # noqa: E402
from jaxbundle.block.unknowns import unknowns_of  # noqa: E402
from jaxbundle.imagery.interest_points import features  # noqa: E402
from jaxbundle.imagery.match_candidates import candidates  # noqa: E402
from jaxbundle.imagery.match_types import MatchOptions  # noqa: E402
from jaxbundle.imagery.matching import match  # noqa: E402
from jaxbundle.imagery.tracks import local_affine  # noqa: E402
from jaxbundle.imagery.window_pairs import PairTable, match_pairs  # noqa: E402
from jaxbundle.imagery.windows import GreyImages  # noqa: E402

DATA = Path(__file__).parents[3] / "shared" / "data"
LEVEL = 3
NEAR = 5.0  # px of the level: candidates with larger y-parallaxes are wrong


def calibration_sheet() -> None:
    """Sigma0 with published and with matched marks, with a given and with an estimated camera."""
    images = {path.stem: grey_image(path) for path in sorted((DATA / "images" / "camcal").glob("*.JPG"))}
    measured = None
    for folder in ("camcal-c1-fixed", "camcal-selfcal-3"):
        block = jb.read(DATA / folder)
        names = [block.structure.image_names[i] for i in block.structure.ray_image]
        marks = np.asarray(block.rays.coordinates)
        if measured is None:
            measured = discs(images, names, marks)
            both = measured[0][measured[1]] - marks[measured[1]]
            print(f"{measured[1].sum()} of {len(marks)} discs; to the marks: mean {both.mean(0)}, sd {both.std(0)} px")
        for what, xy in (("published", marks), ("matched", np.where(measured[1][:, None], measured[0], marks))):
            result = jb.adjust(block.replace(image_coordinates=xy), precision=False)
            robust = 1.4826 * np.median(np.abs(np.asarray(result.residuals[0])))
            print(f"{folder}, {what}: sigma0 {float(result.sigma0):.3f}, robust {robust:.3f} px", flush=True)


def cross(size: int, half_width: float) -> np.ndarray:
    """A light cross on a dark ground."""
    x, y = np.meshgrid(np.arange(size) - (size - 1) / 2, np.arange(size) - (size - 1) / 2)
    inside = np.minimum(np.abs(x), np.abs(y))
    return 30 + 150 / (1 + np.exp((inside - half_width) / 0.8))


def crosses(folder: Path) -> None:
    """Differences of matched crosses and marks set by hand."""
    half, reach, size = 24, 62, 49
    rows = [line.split() for line in (DATA / "images" / "copr" / "gcp_list.txt").read_text().splitlines()[1:]]
    rows = [row for row in rows if len(row) > 6 and (folder / row[5]).is_file()]
    best = []
    for row in rows:
        image = np.pad(grey_image(folder / row[5]), reach, mode="edge")
        at = np.array([float(row[3]), float(row[4])]) + 0.5
        corner = np.floor(at).astype(int) - reach
        window = image[corner[1] + reach :, corner[0] + reach :][: 2 * reach + 1, : 2 * reach + 1]
        starts = []
        for angle in np.radians(np.arange(0, 90, 15)):
            for scale in (0.8, 1.1, 1.5):
                a, b = scale * np.cos(angle), scale * np.sin(angle)
                starts.append([at[0] - corner[0], a, -b, at[1] - corner[1], b, a])
        count = len(starts)
        found = match(
            np.tile(cross(size, 5.0), (count, 1, 1)),
            np.tile(window, (count, 1, 1)),
            np.full((count, 2), half + 0.5),
            np.array(starts),
            MatchOptions(parameters="affine", max_shift=6.0),
        )
        good = found.matched
        if good.any():
            k = np.argmax(np.where(good, np.asarray(found.correlation), -1))
            best.append([*(np.asarray(found.position)[k] + corner - at), *np.asarray(found.sigmas)[k]])
    best = np.array(best).reshape(-1, 4)
    rms = np.sqrt(np.mean(best[:, :2] ** 2))
    print(
        f"{len(best)} of {len(rows)} crosses; to the marks: rms {rms:.2f} px, mean {best[:, :2].mean(0).round(2)},"
        f" maximum {np.abs(best[:, :2]).max():.2f}; median sigma {np.median(best[:, 2:]):.3f} px",
        flush=True,
    )


def parallaxes(folder: Path) -> None:
    """y-parallaxes of matched points in the adjusted orientation."""
    block = jb.adjust(jb.read(DATA / "strasbourg-s4-tie"), precision=False).block
    names = [name for name in block.structure.image_names if (folder / f"{name}.jpg").is_file()]
    if len(names) < 2:
        print("y-parallaxes: the folder has fewer than two of the photographs")
        return
    at = [block.structure.image_names.index(name) for name in names]
    centre = np.asarray(block.exterior.projection_centre)[at]
    rotation = np.asarray(unknowns_of(block).rotation).T.reshape(-1, 3, 3)[at]
    made = [jb.imagery.pyramid(folder / f"{name}.jpg") for name in names]
    found = [features(image, LEVEL, 3000) for image in made]
    greys = GreyImages(dict(enumerate(made)))
    camera = block.structure.cameras[0]
    f, (x0, y0) = 123.939 / 0.006, (4429.5, 6468.5)  # px
    assert (camera.width, camera.height) == (8858, 12996)

    def along(image: int, xy: np.ndarray) -> np.ndarray:
        return np.stack([xy[:, 0] - x0, y0 - xy[:, 1], np.full(len(xy), -f)], 1) @ rotation[image].T

    def parallax(i: int, j: int, one: np.ndarray, two: np.ndarray) -> np.ndarray:
        """Distance of a point from its epipolar line, px of the level."""
        normal = np.cross(centre[j] - centre[i], along(i, one)) @ rotation[j]
        own = np.stack([two[:, 0] - x0, y0 - two[:, 1], np.full(len(two), -f)], 1)
        return (normal * own).sum(1) / np.hypot(normal[:, 0], normal[:, 1]) / 2**LEVEL

    everything = []
    for i, j in combinations(range(len(names)), 2):
        pairs = candidates(found[i].descriptors, found[j].descriptors)
        one, two = found[i].xy[pairs[:, 0]], found[j].xy[pairs[:, 1]]
        near = np.abs(parallax(i, j, one, two)) < NEAR
        one, two = one[near], two[near]
        if len(one) < 20:
            continue
        table = PairTable(np.full(len(one), i), np.full(len(one), j), one, two, local_affine(one, two, one))
        matches = match_pairs(greys, table, LEVEL)
        y = parallax(i, j, one[matches.matched], matches.position[matches.matched])
        everything.append(y)
        print(f"  {names[i]} {names[j]}: {len(one)} candidates, {len(y)} matched, rms {np.sqrt(np.mean(y**2)):.3f} px")
    y = np.concatenate(everything)
    robust = 1.4826 * np.median(np.abs(y - np.median(y)))
    print(f"y-parallaxes of level {LEVEL}: {len(y)} points, rms {np.sqrt(np.mean(y**2)):.3f}, robust {robust:.3f} px")


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--copr", type=Path, default=DATA / "images" / "copr")
    parser.add_argument("--strasbourg", type=Path)
    given = parser.parse_args()
    crosses(given.copr)
    if given.strasbourg:
        parallaxes(given.strasbourg)
    calibration_sheet()


if __name__ == "__main__":
    main()
