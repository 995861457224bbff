"""The simulated blocks of the tests: all have the same shape, so that a process compiles their adjustment once."""

from jaxbundle.planning.flight import AerialCamera
from jaxbundle.planning.simulation import Simulation, simulate

CAMERA = AerialCamera(
    principal_distance=100.0,
    width=104.0,
    height=68.0,
    pixel_size=0.006,
    offset=(0.05, -0.03),
    coefficients={"K1": -2e-6},
    estimate=("principal_distance", "x0", "y0", "K1", "K2"),
)


def small_block(noise: float = 1.0, relief: float = 150.0) -> Simulation:
    """Two strips of four images: weighted and fixed control, observed stations, check points, self-calibration."""
    return simulate(
        2,
        4,
        camera=CAMERA,
        forward_overlap=0.7,
        side_overlap=0.4,
        points_per_image=40,
        control_rows=3,
        control_sigma=(0.05, 0.05, 0.0),
        station_sigma=0.1,
        check_points=3,
        noise=noise,
        relief=relief,
        seed=4,
    )


def long_block(seed: int = 4) -> Simulation:
    """Two strips of twenty images: long enough for two devices to factorise one end each."""
    return simulate(
        2,
        20,
        camera=CAMERA,
        forward_overlap=0.6,
        side_overlap=0.3,
        points_per_image=20,
        control_rows=3,
        control_sigma=(0.05, 0.05, 0.0),
        station_sigma=0.1,
        noise=1.0,
        seed=seed,
    )
