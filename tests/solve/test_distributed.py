"""The points dealt to the devices of two processes: the same answer in both as on one device."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import typer
from cases.simulated_blocks import long_block, small_block
from distributed_worker import found

from jaxbundle.cli import runtime
from jaxbundle.cli.cluster import Cluster, cluster_of
from jaxbundle.cli.codes import Code, LostProcess, told
from jaxbundle.io import read, write_block_folder
from jaxbundle.normals.plan.reduced_plan import Method
from jaxbundle.solve.adjust import adjust

ROOT = Path(__file__).parents[2]
WORKER = Path(__file__).with_name("distributed_worker.py")
CLI = "import sys; from jaxbundle.cli import main, runtime; runtime.MEETING = int(sys.argv.pop(1)); main.main()"
LONGEST, LEFT_ALONE = 300.0, 60.0  # seconds: of a run; of a process that goes on after another has ended


def free_address() -> str:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{s.getsockname()[1]}"


def together(commands: list[list[str]]) -> list[tuple[int, str]]:
    """Exit code and output of processes that run at the same time; none outlives the others for long."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    environment = {**os.environ, "PYTHONPATH": path, "JAX_PLATFORMS": "cpu"}
    running = [
        subprocess.Popen(c, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        for c in commands
    ]
    end, shortened = time.monotonic() + LONGEST, False
    while any(p.poll() is None for p in running) and time.monotonic() < end:
        if not shortened and any(p.poll() is not None for p in running):
            end, shortened = min(end, time.monotonic() + LEFT_ALONE), True
        time.sleep(0.1)
    for p in running:
        p.kill()  # JAX takes SIGTERM for a notice, not for an end
    return [(p.returncode, out) for p, out in ((p, p.communicate()[0]) for p in running)]


def adjusted_by_two(folder: Path, blocks: tuple[Path, Path], solver: str) -> list[tuple[int, str]]:
    common = ["--coordinator", free_address(), "--processes", "2", "--reduced", solver]
    common += ["--checkpoint", str(folder / "state")]
    return together(
        [
            [sys.executable, str(WORKER), str(folder / f"{k}.npz"), "adjust", str(block), *common]
            + ["--out", str(folder / str(k)), "--process", str(k)]
            for k, block in enumerate(blocks)
        ]
    )


@pytest.mark.thorough
@pytest.mark.parametrize("solver", ["panels", "dense"])
def test_two_processes_give_the_answer_of_one_which_the_first_writes(tmp_path: Path, solver: Method) -> None:
    folder = tmp_path / "block"
    write_block_folder(long_block().block, folder)
    processes = adjusted_by_two(tmp_path, (folder, folder), solver)
    for code, output in processes:
        assert code == 0, output
    first, second = (np.load(tmp_path / f"{k}.npz") for k in range(2))
    alone = found(adjust(read(folder), devices=1, reduced=solver))
    assert set(first.files) == set(second.files) == set(alone)
    for name, value in alone.items():
        np.testing.assert_array_equal(second[name], first[name], name)
        # residuals are small differences of large numbers: of the size of the image, not of their own
        size = 1e4 if name == "residuals" else np.abs(value).max()
        np.testing.assert_allclose(first[name], value, rtol=0, atol=1e-12 * size, err_msg=name)
    assert "sigma0" in processes[0][1] and "sigma0" not in processes[1][1]
    assert (tmp_path / "0" / "report.txt").exists() and not (tmp_path / "1").exists()
    assert json.loads((tmp_path / "0" / "report.json").read_text())["sigma0"] == float(first["sigma0"])


def test_two_processes_with_different_blocks_say_so(tmp_path: Path) -> None:
    blocks = tmp_path / "4", tmp_path / "5"
    for block in blocks:
        write_block_folder(long_block(int(block.name)).block, block)
    for code, output in adjusted_by_two(tmp_path, blocks, "panels"):
        assert code == Code.BAD_INPUT
        assert "the 2 processes adjust different blocks" in output


def test_a_process_that_fails_ends_the_others(tmp_path: Path) -> None:
    write_block_folder(small_block().block, tmp_path / "block")
    common = ["--no-precision", "--coordinator", free_address(), "--processes", "2", "--process"]
    command = [sys.executable, "-c", CLI, "30", "adjust"]
    (code, output), (other, _) = together(
        [[*command, str(tmp_path / "nothing"), *common, "0"], [*command, str(tmp_path / "block"), *common, "1"]]
    )
    assert code == 2 and "nothing" in output
    assert other not in (0, -signal.SIGKILL)


def test_a_cluster_that_does_not_meet(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        CLI,
        "3",
        "adjust",
        str(tmp_path),
        "--coordinator",
        free_address(),
        "--processes",
        "2",
    ]
    ((code, output),) = together([[*command, "--process", "1"]])
    assert code == 2
    assert "process 1 of 2 could not connect to the others" in output


LOST = """
import os, time
from jaxbundle.cli.last_words import in_a_sentence
end = in_a_sentence()
os.write(2, b"said before\\nE1126 16:21:31 17692 coordination_service_agent.cc:289] Polled an error\\n")
os.write(2, b"F1126 client.h:80] Terminating process because the JAX distributed service detected fatal errors.\\n")
time.sleep(60)
"""
WELL = LOST.partition('os.write(2, b"F')[0] + "end(); os.write(2, b'said after\\n')"


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        (LOST, 2, "said before\njaxbundle: another process of the cluster was lost, or process 0, the coordinator;"),
        (WELL, 0, "said before\nsaid after\n"),
    ],
)
def test_the_end_of_a_lost_cluster_is_a_sentence(script: str, code: int, words: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=50)
    assert done.returncode == code and done.stderr.startswith(words)
    assert done.stderr.count("\n") == 2


def test_processes_that_were_told_another_number_say_so() -> None:
    runtime._require_count(Cluster("10.0.0.1:4000", 1, 0))
    with pytest.raises(typer.BadParameter, match="--processes 3 here, but 1 for process 0; give the same number"):
        runtime._require_count(Cluster("10.0.0.1:4000", 3, 1))


def test_a_lost_process_is_bad_input_not_an_error_of_the_program() -> None:
    code, words = told(LostProcess(RuntimeError("Connection closed by peer\nmore")))
    assert code is Code.BAD_INPUT
    assert "was lost (Connection closed by peer); see its message, and start all processes again" in words


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("10.0.0.1", 2, 0), "HOST:PORT"),
        (("10.0.0.1:4000", 2, None), "needs --processes N and --process I"),
        (("10.0.0.1:4000", 2, 2), "not from 0 to 1"),
        ((None, 2, 0), "require --coordinator"),
        (("auto", 2, 0), "determines"),
    ],
)
def test_options_that_do_not_belong_together(options: tuple[str | None, int, int | None], words: str) -> None:
    with pytest.raises(typer.BadParameter, match=words):
        cluster_of(*options)
