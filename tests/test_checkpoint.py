"""A solve that is interrupted goes on from its checkpoint to the same result."""

from pathlib import Path

import jax
import numpy as np
import pytest
from simulated import small_block

from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status
from jaxbundle.solve.checkpoint import CheckpointError


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
    again = adjust(block, checkpoint=file)  # nothing is left to do
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
    with pytest.raises(CheckpointError, match="is no checkpoint"):
        adjust(small_block().block, checkpoint=file)
    with pytest.raises(OSError):
        adjust(small_block().block, checkpoint=tmp_path / "nowhere" / "state.npz")
