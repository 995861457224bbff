"""Adjustments of foreign blocks: the same centres from every format, the same cost as COLMAP finds."""

import dataclasses

import numpy as np
import pytest
from cases.rosetta import PLACES, rosetta

from jaxbundle.block.block import Block
from jaxbundle.block.changes import with_interior_held
from jaxbundle.io import read
from jaxbundle.io.formats.assembled import assembled
from jaxbundle.io.formats.foreign_block import ForeignBlock
from jaxbundle.solve.adjust import adjust

SIGMAS = (0.02, 0.02, 0.04)  # m, as three of the formats have them


def alike(foreign: ForeignBlock, control: ForeignBlock) -> ForeignBlock:
    """The block with the control's sigmas and those of all rays as in one format, in px."""
    rays = foreign.rays._replace(sigma=None)
    in_mm = foreign.cameras[0].image_unit == "mm"
    rows = tuple(row._replace(sigmas=SIGMAS) for row in foreign.control)
    return dataclasses.replace(foreign, rays=rays, control=rows, sigma=0.006 if in_mm else 1.0)


@pytest.mark.thorough
def test_all_formats_lead_to_the_same_centres(shared_data):
    """The interior orientation is held; formats round to 0.1 um at worst."""
    first = rosetta(shared_data, "metashape")
    centres = {}
    for name in [name for name in PLACES if name != "bundler"]:  # it has no control
        block = with_interior_held(assembled(alike(rosetta(shared_data, name), first)))
        result = adjust(block, precision=False)
        assert float(result.sigma0) == pytest.approx(0.3533, abs=5e-4)
        centres[name] = np.asarray(result.block.exterior.projection_centre)
    for name, found in centres.items():
        np.testing.assert_allclose(found, centres["metashape"], atol=1e-3, err_msg=name)


@pytest.mark.thorough
def test_colmap_adjusts_to_the_same_cost(shared_data, tmp_path):
    """The same parameters free: poses but for a gauge, points, f and k; not the principal point."""
    pycolmap = pytest.importorskip("pycolmap")
    folder = shared_data / "colmap" / "bin"
    model = pycolmap.Reconstruction(str(folder))
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.max_num_iterations = 200
    options.ceres.solver_options.function_tolerance = 1e-14
    options.ceres.solver_options.gradient_tolerance = 1e-14
    options.ceres.solver_options.parameter_tolerance = 1e-14
    pycolmap.bundle_adjustment(model, options)
    cost = 0.0
    for image in model.images.values():
        for seen in image.points2D:
            if seen.has_point3D():
                point = image.cam_from_world() * model.points3D[seen.point3D_id].xyz
                cost += 0.5 * float(np.sum((model.cameras[image.camera_id].img_from_cam(point) - seen.xy) ** 2))
    block: Block = read(folder, check_start=False)
    result = adjust(block, precision=False)
    assert 0.5 * float(result.vtpv) == pytest.approx(cost, rel=1e-6)
