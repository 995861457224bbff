"""A report says which observation is suspect, what nothing controls, and whose sigmas are wrong."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.planning.simulate import simulate
from jaxbundle.report import report_dict, report_text
from jaxbundle.solve.adjust import adjust
from jaxbundle.statistics.reliability import redundancy_numbers

pytestmark = pytest.mark.xdist_group("diagnosis")  # its fixtures are dear: one worker makes them


@pytest.fixture(scope="module")
def block():
    return simulate(2, 4, forward_overlap=0.7, points_per_image=60, control_rows=4, control_sigma=0.05, seed=6).block


def words(adjustment) -> str:
    return " ".join(" ".join(report_text(adjustment).split()).split())


def test_suspect_control_is_named_with_what_its_removal_does(block):
    control = block.groups[0].values.at[1, 2].add(5.0)
    found = adjust(eqx.tree_at(lambda b: b.groups[0].values, block, control))
    name = block.structure.point_names[block.groups[0].structure.indices[1, 0]]
    report = words(found)
    assert f"control {name} disagrees by" in report and "in Z (w =" in report
    assert "its removal lowers sigma0 from" in report and "check it or drop it" in report
    error = float(report.split(f"control {name} disagrees by ")[1].split()[0])
    assert error == pytest.approx(5.0, abs=0.5)


def test_group_of_wrong_sigmas_is_named(block):
    values = block.groups[0].values + 0.4 * np.random.default_rng(3).normal(size=block.groups[0].values.shape)
    found = adjust(eqx.tree_at(lambda b: b.groups[0].values, block, jnp.where(block.groups[0].sigmas < 1, values, 0.0)))
    assert "control fit worse than the other observations" in words(found)


def test_clean_block_is_not_suspected_and_its_reliability_stands_in_the_report(block):
    found = adjust(block)
    report = words(found)
    assert "disagrees" not in report and "fit worse" not in report
    groups = report_dict(found)["reliability"]
    assert sum(group["observations"] for group in groups.values()) == found.observations
    assert sum(group["redundancy"] for group in groups.values()) == pytest.approx(found.redundancy, rel=1e-9)
    assert all(0 <= group["smallest"] <= group["mean"] <= 1 for group in groups.values())
    assert "Reliability" in report and "largest MDE" in report


def test_error_along_the_base_is_controlled_less(block):
    """A point on two images of one strip: an error along the base moves the point and nothing else."""
    s = block.structure
    two = np.bincount(s.ray_point)[s.ray_point] == 2
    r = redundancy_numbers(adjust(block))[0][two]
    assert (r[:, 0] < r[:, 1]).mean() > 0.9
