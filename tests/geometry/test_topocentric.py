"""Positions on the ellipsoid in a topocentric system."""

import numpy as np
import pytest

from jaxbundle.geometry.topocentric import geocentric, topocentric


def test_point_on_the_equator_and_at_the_pole():
    xyz = geocentric(np.array([[0.0, 0.0, 10.0], [90.0, 0.0, 0.0]]))
    assert xyz[0] == pytest.approx([6378147.0, 0, 0])
    assert xyz[1] == pytest.approx([0, 0, 6356752.314245], abs=1e-6)


def test_axes_are_east_north_up():
    origin = np.array([46.84, -91.99, 198.0])
    near = origin + [[0, 1e-5, 0], [1e-5, 0, 0], [0, 0, 2.0]]
    east, north, up = topocentric(near, origin)
    assert east == pytest.approx([0.7627, 0, 0], abs=1e-3)
    assert north == pytest.approx([0, 1.1117, 0], abs=1e-3)
    assert up == pytest.approx([0, 0, 2.0], abs=1e-9)
