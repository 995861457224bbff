"""Batches: every block as by itself, in any order; one that fails is told and stops no other."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.block.block import Block
from jaxbundle.block.datum import with_datum
from jaxbundle.block.findings import Finding, Kind
from jaxbundle.block.problems import BlockError
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve import batch as module
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.batch import Batch, Outcome, adjust_many, table_lines


def strip(seed: int, points: int = 30) -> Block:
    return simulate(1, 3, points_per_image=points, seed=seed).block


def broken() -> Block:
    return eqx.tree_at(lambda b: b.rays.sigmas, strip(0), replace_fn=lambda s: s.at[4].set(-1.0))


@pytest.fixture(scope="module")
def blocks() -> dict[str, Block]:
    return {"one": strip(1), "broken": broken(), "two": strip(2, 36)}


@pytest.fixture(scope="module")
def batch(blocks) -> Batch:
    return adjust_many(blocks, precision=False)


def test_every_block_is_adjusted_as_by_itself(blocks, batch):
    assert [outcome.name for outcome in batch.outcomes] == ["one", "broken", "two"]
    assert isinstance(batch.outcomes[1].result, BlockError)
    for adjustment, name in zip(batch.adjustments, ("one", "two"), strict=True):
        alone = adjust(blocks[name], precision=False)
        assert eqx.tree_equal(adjustment.block.object_points, alone.block.object_points)
        assert adjustment.status is Status.CONVERGED and adjustment.cofactors is None


def test_order_has_no_influence(blocks, batch):
    again = adjust_many(dict(reversed(blocks.items())), precision=False)
    there, back = ({row.name: row._replace(seconds=0.0) for row in b.table()} for b in (batch, again))
    assert there == back and list(there) != list(back)


def test_similar_blocks_share_their_programs(batch, monkeypatch):
    from_now_on = []
    monkeypatch.setattr("jax.stages.Lowered.compile", lambda *a, **k: from_now_on.append(a) or 1 / 0)
    again = adjust_many([strip(1), strip(2, 36)], precision=False)
    assert again.trustworthy and not from_now_on


def test_table(batch):
    one, failed, two = batch.table()
    assert one.status == two.status == "converged" and one.problem == two.problem == ""
    assert (one.observations, one.unknowns) == (batch.adjustments[0].n_observations, batch.adjustments[0].n_unknowns)
    assert one.redundancy == batch.adjustments[0].redundancy and one.iterations > 1
    assert one.sigma0 == pytest.approx(float(batch.adjustments[0].sigma0))
    assert failed[:2] == ("broken", "bad input") and failed[2:7] == (None,) * 5
    assert "a sigma is not positive; give a positive standard deviation" in failed.problem
    assert not batch.trustworthy and min(one.seconds, failed.seconds) > 0


def test_summary_is_aligned(batch):
    header, *lines = batch.summary().splitlines()
    assert header.split() == list(module.Row._fields)
    at = header.index("sigma0") + len("sigma0")
    assert [line[at - 1 : at + 2].count(" ") for line in lines] == [2, 2, 2] and lines[1][at - 1] == "-"
    row = batch.table()[1]._replace(problem="a word " * 100)
    assert len(table_lines([row])[1]) < 200 and table_lines([row])[1].endswith("...")


def test_progress_and_equal_names():
    seen: list[Outcome] = []
    unnamed = dataclasses.replace(strip(1), structure=dataclasses.replace(strip(1).structure, name=""))
    batch = adjust_many(iter([strip(1), strip(2), unnamed]), precision=False, max_iterations=1, progress=seen.append)
    assert [o.name for o in batch.outcomes] == ["1 x 3 images", "1 x 3 images-2", "(unnamed)"]
    assert seen == list(batch.outcomes)
    assert all("maximum number of iterations (not converged)" in row.problem for row in batch.table())


def test_undetermined_unknowns_are_named(monkeypatch, batch):
    weak = dataclasses.replace(batch.adjustments[0], findings=(Finding(Kind.UNDETERMINED, "point 7", "drop it"),))
    monkeypatch.setattr(module, "adjust", lambda block, **options: weak)
    found = adjust_many([strip(1)])
    assert not found.trustworthy and found.table()[0].problem == "point 7; drop it"


def test_ctrl_c_ends_the_batch(monkeypatch, batch):
    stopped = eqx.tree_at(lambda a: a.iterations.status, batch.adjustments[0], jnp.asarray(int(Status.INTERRUPTED)))
    monkeypatch.setattr(module, "adjust", lambda block, **options: stopped)
    assert [o.name for o in adjust_many({"a": strip(1), "b": strip(1)}).outcomes] == ["a"]


def test_wrong_options_are_told_before_the_first_block():
    def never():
        raise AssertionError
        yield

    with pytest.raises(ValueError, match="no method 'newton'"):
        adjust_many(never(), method="newton")
    with pytest.raises(ValueError, match="conjugate gradients give no standard deviations"):
        adjust_many(never(), reduced="pcg")


def test_observations_of_one_block_go_through_vmap(blocks):
    """Also in two directions."""
    block = with_datum(blocks["one"])
    shifts = jnp.asarray(np.random.default_rng(0).normal(0, 0.005, (2, 2, *block.rays.coordinates.shape)))

    def one(shift):
        drawn = eqx.tree_at(lambda b: b.rays.coordinates, block, block.rays.coordinates + shift)
        found = adjust(drawn, precision=False)
        return found.block.object_points, found.sigma0, found.iterations.trials, found.iterations.history

    points, sigma0, trials, history = jax.jit(jax.vmap(jax.vmap(one)))(shifts.at[0, 0].set(0.0))
    for k, expected in (((0, 0), one(0.0 * shifts[0, 0])), ((1, 1), one(shifts[1, 1]))):
        np.testing.assert_allclose(points[k], expected[0], rtol=1e-9, atol=1e-8)
        assert sigma0[k] == pytest.approx(float(expected[1]), rel=1e-9) and trials[k] == expected[2]
        n = int(expected[2])
        np.testing.assert_allclose(history.cost[k][:n], expected[3].cost[:n], rtol=1e-6)
        np.testing.assert_array_equal(history.accepted[k], expected[3].accepted)
        assert np.isnan(history.cost[k][n:]).all() and history.cost[k].shape == expected[3].cost.shape == (200,)


def test_no_block():
    assert adjust_many([]).table() == [] and adjust_many([]).trustworthy


def test_an_interruption_before_an_accepted_step_ends_the_batch(blocks, batch, monkeypatch):
    done = iter([batch.adjustments[0]])

    def one_only(block, **options):
        for adjustment in done:
            return adjustment
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "adjust", one_only)
    assert [outcome.name for outcome in adjust_many(blocks).outcomes] == ["one"]
