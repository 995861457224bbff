"""`jaxbundle adjust` of several paths: a folder each, a table of all, the worst exit code, workers that end."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from jaxbundle.cli import main, runtime, several
from jaxbundle.cli.adjusting import Outcome
from jaxbundle.cli.codes import Code
from jaxbundle.io import write_block_folder
from jaxbundle.planning.simulation import simulate
from jaxbundle.solve.adjust import adjust
from jaxbundle.solve.adjustment import Status

ROOT = Path(__file__).parents[2]
FILES = {
    "cameras.csv",
    "check_points.csv",
    "images.csv",
    "points.csv",
    "rays.csv",
    "report.html",
    "report.json",
    "report.txt",
}


@pytest.fixture(scope="module")
def blocks(tmp_path_factory) -> Path:
    """a/strip and b/strip, which have the same name, c/other, and one that is broken."""
    home = tmp_path_factory.mktemp("jobs")
    block, errors = simulate(1, 3, points_per_image=30).block, np.random.default_rng(5)
    for name in ("a/strip", "b/strip", "c/other"):  # of one structure: they share their programs
        measured = block.rays.coordinates + errors.normal(0.0, 1e-3, block.rays.coordinates.shape)
        write_block_folder(eqx.tree_at(lambda b: b.rays.coordinates, block, measured), home / name)
    shutil.copytree(home / "a" / "strip", home / "broken")
    with (home / "broken" / "rays.csv").open("a") as rays:
        rays.write("9_09,20,1,1,,\n")
    return home


@pytest.fixture
def run(blocks, monkeypatch, capsys, pytestconfig):
    """Runs `adjust` beside the blocks; exit code, standard output, standard error."""
    monkeypatch.chdir(blocks)
    monkeypatch.setattr(runtime, "start", lambda cluster: None)  # of this process; workers start for themselves
    monkeypatch.setenv("XDG_CACHE_HOME", str(pytestconfig.cache.mkdir("workers")))

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["jaxbundle", "adjust", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.main()
        return int(ended.value.code or 0), *capsys.readouterr()

    return call


def rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "adjustments.csv").open(newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def test_two_workers(run, blocks):
    """Every path as by itself, whatever becomes of the others."""
    code, out, err = run("a/strip", "broken", "b/strip", "nowhere", "c/other", "--jobs", 2, "--out", "results")
    assert code == 2
    assert "jaxbundle: broken: 1 problem in the block" in err and "jaxbundle: nowhere: 1 problem" in err
    table = rows(blocks / "results")
    assert list(table) == ["strip", "broken", "strip-2", "nowhere", "other"]
    assert [row["status"] for row in table.values()] == [
        "converged",
        "bad input",
        "converged",
        "bad input",
        "converged",
    ]
    assert [line.split()[0] for line in out.splitlines()] == ["name", *table, "Results:"]
    assert table["strip-2"]["path"] == "b/strip" and "nowhere does not exist; give" in table["nowhere"]["problem"]
    assert {path.name for path in (blocks / "results").iterdir()} == {"adjustments.csv", "strip", "strip-2", "other"}
    alone, _, _ = run("b/strip", "--out", "alone")
    assert alone == 0 and {path.name for path in (blocks / "alone").iterdir()} == FILES
    assert (blocks / "alone" / "points.csv").read_bytes() == (
        blocks / "results" / "strip-2" / "points.csv"
    ).read_bytes()
    assert "tests" not in {path.name for path in blocks.iterdir()}


def test_one_process_after_the_other(run, blocks, monkeypatch):
    code, out, err = run("a/strip", "b/strip")
    assert (code, err) == (0, "") and out.endswith("Results: adjustments\n")
    assert list(rows(blocks / "adjustments")) == ["strip", "strip-2"]
    # the search for causes, which adjusts other blocks, has its own tests
    monkeypatch.setattr("jaxbundle.diagnosis.adjusted.causes", lambda *_: ())
    code, out, _ = run("a/strip", "c/other", "--max-iterations", 1, "--no-precision")
    assert code == 1 and "stopped at the maximum number of iterations (not converged)" in out
    assert list(rows(blocks / "adjustments")) == ["strip", "other"]  # an earlier table is replaced


def test_no_place_for_results(run, blocks):
    folder = blocks / "taken"
    folder.mkdir()
    (folder / "adjustments.csv").write_text("mine")
    code, out, err = run("a/strip", "b/strip", "--out", folder)
    assert (code, out) == (2, "") and "is not a table of adjustments; give another folder" in err
    code, out, err = run("a/strip", "b/strip", "--out", folder / "adjustments.csv")
    assert (code, out) == (2, "") and "is a file; give a folder" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--checkpoint", "state"), "--checkpoint and a cluster support one block only"),
        (("--jobs", "0"), "greater than or equal to 1"),
    ],
)
def test_wrong_options(run, options, message):
    code, out, err = run("a/strip", "b/strip", *options)
    assert (code, out) == (2, "") and message in " ".join(err.replace("│", " ").split())


def test_options_that_do_not_fit_one_block(run, blocks):
    options = "--stop", "unknown", "--limit", "1", "--unknown", "9_09:X0", "--out", "misfit"
    code, _, err = run("a/strip", "b/strip", *options)
    assert code == 2 and err.count("no unknown X0 of 9_09") == 2 and "Traceback" not in err


def test_names_never_collide():
    paths = [Path("a/x"), Path("b/x"), Path("x-2"), Path("adjustments.csv.txt"), Path("c/x.txt")]
    folders = [task.folder.name for task in several.named(paths, Path("out"))]
    assert folders == ["x", "x-2", "x-2-2", "adjustments.csv-2", "x-3"] and len(set(folders)) == 5


def test_interrupted_block_ends_those_after_it(run, blocks, monkeypatch):
    adjustment = adjust(simulate(1, 3, points_per_image=30, seed=0).block)
    stopped = eqx.tree_at(
        lambda a: a.iterations.status, adjustment, adjustment.iterations.status * 0 + Status.INTERRUPTED
    )
    monkeypatch.setattr(several, "adjust_path", lambda *_: Outcome(stopped, (), None, Code.NOT_TRUSTED))
    code, _, _ = run("a/strip", "b/strip", "--out", "interrupted")
    table = rows(blocks / "interrupted")
    assert code == 130 and [row["status"] for row in table.values()] == ["interrupted", "not adjusted"]
    assert "run it again" in table["strip-2"]["problem"]


def runs(pid: str) -> bool:
    """Whether there is such a process; one that has ended may be there until its status is asked for."""
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts processes as Linux does")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_the_workers(blocks, tmp_path, how):
    # whoever runs the tests may ignore Ctrl-C, which children take over
    hears = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    script = f"{hears}; from jaxbundle.cli.main import main; main()"
    command = [sys.executable, "-c", script, "adjust", "a/strip", "b/strip", "--jobs", "2", "--out", str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    process = subprocess.Popen(command, cwd=blocks, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    children = Path(f"/proc/{process.pid}/task")
    workers: set[str] = set()
    while len(workers) < 3 and process.poll() is None:  # two workers, and Python's own tracker of what they share
        workers = {pid for thread in children.iterdir() for pid in (thread / "children").read_text().split()}
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(how)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130 and b"Traceback" not in err
    assert err.count(b"Ctrl-C again stops immediately") == 1
    assert out.count(b"not adjusted") == 2
    time.sleep(1.0)  # the tracker ends when it finds itself alone
    assert not [pid for pid in workers if runs(pid)]
    assert {path.name for path in tmp_path.iterdir()} <= {"adjustments.csv", "cache"}
