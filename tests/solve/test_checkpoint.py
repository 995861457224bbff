"""A solve that is interrupted goes on from its checkpoint to the same result."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.numerics import whole_files
from jaxbundle.solve import levenberg_marquardt
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.checkpoint import Checkpointer, CheckpointError, load, save
from jaxbundle.solve.weight_functions import Huber


def test_goes_on_to_the_same_result(tmp_path: Path) -> None:
    block, file = small_block().block, tmp_path / "state.npz"
    whole = adjust(block)
    first = adjust(block, max_iterations=3, checkpoint=file, precision=False)
    assert first.status is Status.MAXIMUM_ITERATIONS
    second = adjust(block, checkpoint=file)
    assert second.status is Status.CONVERGED
    assert int(second.iterations.trials) == int(whole.iterations.trials)
    for a, b in zip(jax.tree.leaves(whole.block), jax.tree.leaves(second.block), strict=True):
        np.testing.assert_array_equal(a, b)
    again = adjust(block, checkpoint=file)  # the last step is done again
    assert int(again.iterations.trials) == int(whole.iterations.trials)
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_interruption_keeps_the_last_accepted_state(tmp_path: Path) -> None:
    block, file = small_block().block, tmp_path / "state.npz"

    def interrupt(progress) -> None:
        if progress.iteration == 4:
            raise KeyboardInterrupt

    stopped = adjust(block, checkpoint=file, progress=interrupt, precision=False)
    assert stopped.status is Status.INTERRUPTED
    assert float(stopped.iterations.final_cost) < float(stopped.iterations.initial_cost)
    assert adjust(block, checkpoint=file, precision=False).status is Status.CONVERGED


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    adjust(small_block().block, max_iterations=1, checkpoint=file, precision=False)
    with pytest.raises(CheckpointError, match="another block or method; delete it"):
        adjust(small_block(noise=2.0).block, checkpoint=file)
    file.write_text("no checkpoint")
    with pytest.raises(CheckpointError, match="is not a checkpoint"):
        adjust(small_block().block, checkpoint=file)
    with pytest.raises(OSError, match="state.npz cannot be written: No such file or directory; name another file"):
        adjust(small_block().block, checkpoint=tmp_path / "nowhere" / "state.npz")


def interrupt_at(iteration: int):
    """A progress callback like a Ctrl-C that nobody lets go of."""

    def interrupt(progress) -> None:
        if progress.iteration >= iteration:
            raise KeyboardInterrupt

    return interrupt


def test_an_interruption_before_the_first_accepted_step_is_raised(monkeypatch) -> None:
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(levenberg_marquardt, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        adjust(small_block().block, precision=False)


def test_an_interrupted_adjustment_is_not_kept_waiting_for_standard_deviations() -> None:
    stopped = adjust(small_block().block, progress=interrupt_at(3))
    assert stopped.status is Status.INTERRUPTED and stopped.cofactors is None


def test_an_interrupted_robust_adjustment_ends() -> None:
    calls = []

    def interrupt(progress) -> None:
        calls.append(progress.iteration)
        if len(calls) >= 9:
            raise KeyboardInterrupt

    stopped = adjust(small_block().block, robust=Huber(), progress=interrupt)
    assert stopped.status is Status.INTERRUPTED
    assert stopped.reweighting is not None and not stopped.reweighting.settled
    assert len(calls) <= 10


def solve_of(values: float, status: int, cost: float) -> tuple[Any, Any]:
    """Unknowns and a state of a solve, as a checkpoint keeps them."""
    unknowns = {"points": jnp.arange(3.0) + values, "rotation": jnp.ones((2, 2))}
    return unknowns, {"status": jnp.array(status), "cost": jnp.array(cost)}


STATE, FINISHED = solve_of(0.0, 0, jnp.nan), solve_of(1.0, 1, 2.0)


def foreign(path: Path, arrays: dict[str, list]) -> None:
    with path.open("wb") as file:
        given: dict[str, Any] = {name: np.array(array) for name, array in arrays.items()}
        np.savez(file, fingerprint=np.array("mark"), **given)


def test_what_a_file_holds_is_looked_at(tmp_path: Path, unchecked_types) -> None:
    file = tmp_path / "state"
    save(file, "mark", *FINISHED)
    found: Any = load(file, "mark", *STATE)
    unknowns, state = found
    np.testing.assert_array_equal(unknowns["points"], [1, 2, 3])
    assert float(state["cost"]) == 2.0
    broken = {
        "float64 of shape \\(2,\\) instead of float64 of shape \\(3,\\)": jnp.ones(2),
        "int64 of shape": jnp.arange(3),
        "not a finite number": jnp.array([1.0, jnp.nan, 2.0]),
        "damaged": jnp.ones(100_000),
    }
    for words, leaf in broken.items():
        spoilt: Any = {**FINISHED[0], "points": leaf}
        save(file, "mark", spoilt, FINISHED[1])
        with pytest.raises(CheckpointError, match=words):
            load(file, "mark", *STATE)
    foreign(file, {f"leaf {k}": ["text"] for k in range(4)})
    with pytest.raises(CheckpointError, match="delete it or name another file"):
        load(file, "mark", *STATE)
    foreign(file, {"leaf 0": [1.0]})
    with pytest.raises(CheckpointError, match="contains 1 arrays instead of 4"):
        load(file, "mark", *STATE)


def test_a_state_that_says_converged_is_not_believed(tmp_path: Path, monkeypatch) -> None:
    block, file = small_block().block, tmp_path / "state"
    whole = adjust(block, checkpoint=file, precision=False)
    resumed = Checkpointer.resumed

    def tampered(self, unknowns, state):
        unknowns, state = resumed(self, unknowns, state)
        moved = jax.tree.map(lambda x: x * (1 + 1e-5), unknowns)
        return moved, state._replace(ended=jnp.array(True))

    monkeypatch.setattr(Checkpointer, "resumed", tampered)
    again = adjust(block, checkpoint=file, precision=False)
    assert float(again.sigma0) == pytest.approx(float(whole.sigma0), rel=1e-3)  # what is held has moved too
    assert int(again.iterations.trials) >= int(whole.iterations.trials)


def test_nothing_is_left_where_a_checkpoint_cannot_be_written(tmp_path: Path, monkeypatch, unchecked_types) -> None:
    (tmp_path / whole_files.marked_name()).write_text("being written")
    planted = tmp_path / "state.part"
    planted.symlink_to(tmp_path / "elsewhere")
    monkeypatch.setattr(whole_files.os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device; name another file"):
        save(tmp_path / "state", "mark", *FINISHED)
    assert not (tmp_path / "elsewhere").exists() and not (tmp_path / "state").exists()
    assert len(list(tmp_path.iterdir())) == 2


def test_what_a_killed_process_left_is_removed(tmp_path: Path, monkeypatch, unchecked_types) -> None:
    left = tmp_path / whole_files.marked_name()
    left.write_text("half a checkpoint")
    monkeypatch.setattr(whole_files, "_start", lambda process: 1)  # the process of that number is another one by now
    save(tmp_path / "state", "mark", *FINISHED)
    assert [path.name for path in tmp_path.iterdir()] == ["state"]


def full(_: int) -> None:
    raise OSError(28, "No space left on device")
