"""Flat, vertical blocks: what they cannot determine is not trusted, and what bends them goes with observed stations."""

import numpy as np
import pytest

import jaxbundle as jb
from jaxbundle.block.findings import Kind, Severity
from jaxbundle.planning.flight import AerialCamera

pytestmark = pytest.mark.thorough


def test_a_principal_distance_over_flat_ground_is_not_trusted():
    """Exactly vertical images of a plane: principal distance and flying height are one unknown.

    Rounding decides whether the solve ends on the way along it or at an undetermined minimum.
    """
    camera = AerialCamera(estimate=("principal_distance",))
    simulated = jb.simulate(2, 3, camera=camera, relief=0.0, tilt=0.0, points_per_image=30, control_rows=2, seed=1)
    result = jb.adjust(simulated.block)
    assert not result.trustworthy
    named = [f for f in jb.findings(result, simulated.block) if f.severity is Severity.FAILED]
    assert {f.kind for f in named} <= {Kind.WEAK, Kind.UNDETERMINED, Kind.NOT_CONVERGED}
    assert "principal_distance" in {subject.component for f in named for subject in f.subjects}
    deviation = float(result.standard_deviations.interior[0, 0])
    assert not deviation < abs(float(result.block.interior.elements[0, 0]))


def test_stations_straighten_what_a_wrong_distortion_bends():
    """A distortion of 0.08 mm in the corners that the block takes as 0, control at both ends: the middle bends; with
    stations of 0.02 m it does not."""
    camera = AerialCamera(coefficients={"K1": 3e-8}, errors={"K1": 3e-8})
    bent = []
    for sigma in (None, 0.02):
        simulated = jb.simulate(
            2, 7, camera=camera, relief=0.0, points_per_image=30, control_rows=2, station_sigma=sigma, noise=0.0, seed=1
        )
        result = jb.adjust(simulated.block, precision=False)
        truth = np.asarray(simulated.truth.object_points)
        middle = np.abs(truth[:, 0] - truth[:, 0].mean()) < 0.25 * np.ptp(truth[:, 0])
        bent.append(abs((np.asarray(result.block.object_points) - truth)[middle, 2].mean()))
    assert bent[0] > 1.0 and bent[1] < 0.3 * bent[0]
