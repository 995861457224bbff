"""Minimises a BAL file by pycolmap's bundle adjustment; prints Ceres's table of iterations and the cost: FILE THREADS

BAL looks along -z with y up, COLMAP along +z with y down: all z and y of an image's system change sign, so measured y
does too and all residuals keep their size. The camera model RADIAL (f, cx, cy, k1, k2) distorts as BAL does. The gauge
is left free, as in the other programs: damping holds it.
"""

import sys
from typing import Any

import numpy as np
import pycolmap  # pyright: ignore[reportMissingImports]
from pycolmap import pyceres  # pyright: ignore[reportMissingImports]

TURN = np.diag([1.0, -1.0, -1.0])  # colmap_from_bal


def reconstruction_of(path: str) -> pycolmap.Reconstruction:
    """Cameras, images and points of the file; COLMAP numbers points from 1."""
    with open(path) as file:
        images, points, rays = map(int, file.readline().split())
        numbers = np.fromstring(file.read(), sep=" ")
    ray, parameters, coordinates = np.split(numbers, [4 * rays, 4 * rays + 9 * images])
    ray, parameters = ray.reshape(-1, 4), parameters.reshape(-1, 9)
    image, point = ray[:, :2].astype(int).T
    by_image = np.argsort(image, kind="stable")
    first = np.searchsorted(image[by_image], np.arange(images + 1))
    place = np.empty(rays, int)  # of a ray among those of its image
    place[by_image] = np.arange(rays) - first[image[by_image]]

    block = pycolmap.Reconstruction()
    for k, (*vector, x, y, z, f, k1, k2) in enumerate(parameters):
        # width and height only bound the focal length that COLMAP believes
        block.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=k + 1, model="RADIAL", width=2000, height=2000, params=[f, 0.0, 0.0, k1, k2])
        )
        measured = ray[by_image[first[k] : first[k + 1]], 2:] * [1.0, -1.0]
        turned = pycolmap.Rotation3d(TURN @ pycolmap.Rotation3d(np.array(vector)).matrix())
        block.add_image_with_trivial_frame(
            pycolmap.Image(name=str(k), keypoints=measured, camera_id=k + 1, image_id=k + 1),
            pycolmap.Rigid3d(turned, TURN @ [x, y, z]),
        )
    by_point = np.argsort(point, kind="stable")
    members = [pycolmap.TrackElement(i + 1, k) for i, k in zip(image[by_point], place[by_point], strict=True)]
    border = np.searchsorted(point[by_point], np.arange(points + 1))
    for j, xyz in enumerate(coordinates.reshape(-1, 3)):
        block.add_point3D(xyz, pycolmap.Track(members[border[j] : border[j + 1]]))
    return block


def options(threads: int) -> pycolmap.BundleAdjustmentOptions:
    """No loss function, tolerances as the other programs; the linear solver is COLMAP's choice by size."""
    chosen = pycolmap.BundleAdjustmentOptions()
    chosen.refine_focal_length = chosen.refine_extra_params = True
    chosen.refine_principal_point = chosen.print_summary = False
    chosen.ceres.loss_function_type = pycolmap.LossFunctionType.TRIVIAL
    chosen.ceres.min_num_residuals_for_cpu_multi_threading = 0  # else a small block gets one thread
    solver = chosen.ceres.solver_options
    solver.num_threads, solver.max_num_iterations = threads, 100
    solver.function_tolerance = 1e-12
    solver.gradient_tolerance = solver.parameter_tolerance = 1e-16
    solver.minimizer_progress_to_stdout, solver.logging_type = True, pyceres.LoggingType.PER_MINIMIZER_ITERATION
    chosen.ceres.solver_options = solver
    return chosen


def main() -> None:
    """Reads, adjusts, prints."""
    block = reconstruction_of(sys.argv[1])
    config = pycolmap.BundleAdjustmentConfig()
    for image in block.images:
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.UNSPECIFIED)
    adjuster: Any = pycolmap.create_default_ceres_bundle_adjuster(options(int(sys.argv[2])), config, block)
    print("cost", repr(adjuster.solve().ceres_summary.final_cost))


if __name__ == "__main__":
    main()
