"""Signalised targets of a calibration sheet, matched with a drawn disc."""

import numpy as np
import pytest
from cases.targets import discs
from cases.textures import grey_image

import jaxbundle as jb


@pytest.mark.thorough
def test_discs_of_a_calibration_sheet(shared_data):
    """The sheet is adjusted with the published marks and with matched ones; the camera is estimated from each."""
    images = {path.stem: grey_image(path) for path in sorted((shared_data / "images" / "camcal").glob("*.JPG"))}
    block = jb.read(shared_data / "camcal-selfcal-3")
    names = [block.structure.image_names[i] for i in block.structure.ray_image]
    marks = np.asarray(block.rays.coordinates)
    measured, matched = discs(images, names, marks)
    assert matched.all()
    difference = measured - marks
    assert np.abs(difference.mean(0)).max() < 0.02 and difference.std() < 0.2
    sigma0 = [float(jb.adjust(block.replace(image_coordinates=xy), precision=False).sigma0) for xy in (marks, measured)]
    assert sigma0[1] < 1.78  # unit 0.1 px: that of the published marks with the published camera
    assert sigma0[1] < 1.02 * sigma0[0]
