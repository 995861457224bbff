"""Robust estimation: gross errors are found and named, and the estimates are those of the clean block."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.planning.simulation import simulate
from jaxbundle.solve import reweighting as solve_reweighting
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.weight_functions import WEIGHT_FUNCTIONS, Huber, Tukey

GROSS, SHARE = 50.0, 0.05  # sigmas; of the rays


@pytest.fixture(scope="module")
def clean():
    return simulate(3, 6, forward_overlap=0.8, side_overlap=0.6, points_per_image=60, control_sigma=0.05, seed=2).block


@pytest.fixture(scope="module")
def spoilt(clean):
    """5 % of the rays are 50 sigma off, in any direction; all on points that are seen on five images or more."""
    rng = np.random.default_rng(5)
    rays = len(clean.structure.ray_image)
    bad = np.zeros(rays, bool)
    point = clean.structure.ray_point
    controlled = np.flatnonzero(np.bincount(point)[point] >= 5)
    bad[rng.choice(controlled, round(SHARE * rays), replace=False)] = True
    turn = rng.uniform(0, 2 * np.pi, rays)
    errors = GROSS * np.asarray(clean.rays.sigmas) * np.stack([np.cos(turn), np.sin(turn)], 1) * bad[:, None]
    return eqx.tree_at(lambda b: b.rays.coordinates, clean, clean.rays.coordinates + errors), bad


@pytest.fixture(scope="module")
def reference(clean):
    return adjust(clean)


@pytest.mark.parametrize("name", WEIGHT_FUNCTIONS)
def test_all_gross_errors_are_found(clean, reference, spoilt, name):
    block, bad = spoilt
    robust = adjust(block, robust=WEIGHT_FUNCTIONS[name]())
    assert robust.reweighting is not None
    weights = np.asarray(robust.reweighting.weights)
    assert (weights[bad] < 0.5).all()
    # Cauchy's weight is a half at 2.4 sigma already, which one normal ray in seventeen exceeds
    assert (weights[~bad] < 0.5).mean() < (0.08 if name == "cauchy" else 0.02)
    sd = reference.standard_deviations
    off = (
        np.asarray(robust.block.exterior.projection_centre) - reference.block.exterior.projection_centre
    ) / sd.projection_centre
    assert np.sqrt((off**2).mean()) < (1.0 if name == "huber" else 0.4)
    assert robust.trustworthy and "Robust weights" in robust.summary()
    np.testing.assert_array_equal(robust.block.rays.sigmas, clean.rays.sigmas)


def test_least_squares_is_never_robust_by_itself(spoilt):
    assert adjust(spoilt[0]).reweighting is None


def test_clean_block_keeps_its_weights(clean):
    reweighting = adjust(clean, robust=Tukey()).reweighting
    assert reweighting is not None
    weights = np.asarray(reweighting.weights)
    assert (weights < 0.5).mean() < 0.05 and weights.mean() > 0.9


def test_weights_that_do_not_settle_are_told(spoilt, monkeypatch):
    monkeypatch.setattr(solve_reweighting, "MAX_ROUNDS", 2)
    reweighting = adjust(spoilt[0], robust=Huber()).reweighting
    assert reweighting is not None and reweighting.rounds == 2 and not reweighting.settled


def test_weights_cannot_be_traced_and_keep_no_checkpoint(clean, tmp_path):
    with pytest.raises(ValueError, match="inside jit"):
        jax.eval_shape(
            lambda b: adjust(b, robust=Huber()).sigma0, eqx.tree_at(lambda b: b.rays.sigmas, clean, clean.rays.sigmas)
        )
    with pytest.raises(ValueError, match="`checkpoint` is not supported"):
        adjust(clean, robust=Huber(), checkpoint=tmp_path / "state")


@pytest.mark.parametrize("name", WEIGHT_FUNCTIONS)
def test_weight_functions(name):
    t = jnp.linspace(0, 20, 400)
    weights = np.asarray(WEIGHT_FUNCTIONS[name]().weights(t))
    assert weights[0] == 1 and (np.diff(weights) <= 1e-15).all() and (weights >= 0).all()
