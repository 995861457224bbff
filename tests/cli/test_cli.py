"""The command line: what it prints where, its exit codes, and what it leaves behind."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from cases.simulated_blocks import small_block

from jaxbundle.cli import adjusting, codes, demo, progress
from jaxbundle.cli.interruption import Interruption
from jaxbundle.cli.progress import HEADER, ProgressLines
from jaxbundle.io import read, write_block_folder
from jaxbundle.solve.adjust import Progress, adjust
from jaxbundle.solve.stopping_rules import AngleRule, ParallaxRule, PointRule, UnknownRule
from jaxbundle.solve.weight_functions import Huber, Tukey

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The small block as a block folder."""
    path = tmp_path_factory.mktemp("cli") / "small"
    write_block_folder(small_block().block, path)
    return path


@pytest.fixture(scope="module")
def adjustment(folder):
    """Its adjustment."""
    return adjust(read(folder))


def test_version_and_help(run):
    assert run("--version") == (0, "jaxbundle 0.1.0\n", "")
    code, out, _ = run("--help")
    assert code == 0 and all(command in out for command in ("adjust", "check-partials", "demo", "convert"))


def test_adjusts_and_is_silent_in_a_pipe(run, folder, tmp_path):
    code, out, err = run("adjust", folder)
    assert (code, err) == (0, "")
    assert "converged" in out and out.endswith("Results: small-adjusted\n")
    report = json.loads((tmp_path / "small-adjusted" / "report.json").read_text())
    assert report["trustworthy"] and report["name"] == "2 x 4 images"
    assert {"block.toml", "rays.csv"} <= set(report["inputs"]) and report["command"].startswith("jaxbundle adjust")
    assert [path.name for path in tmp_path.iterdir()] == ["small-adjusted"]


@pytest.mark.parametrize("searched", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_not_to_be_trusted_is_1_and_written_all_the_same(run, folder, tmp_path, monkeypatch, searched):
    """The search for causes adjusts other blocks: it has its own tests, and finds none here."""
    if not searched:
        monkeypatch.setattr("jaxbundle.diagnosis.adjusted.causes", lambda *_: ())
    code, out, err = run("adjust", folder, "--max-iterations", 1, "--out", "few", "--no-precision")
    assert (code, err) == (1, "") and "not converged" in out and "allow more iterations" in out
    assert json.loads((tmp_path / "few" / "report.json").read_text())["status"] == "maximum iterations"


def test_ctrl_c_keeps_the_last_accepted_unknowns(run, folder, tmp_path, monkeypatch):
    def interrupted(_, progress: Progress) -> None:
        if progress.iteration == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(ProgressLines, "iteration", interrupted)
    code, out, _ = run("adjust", folder, "--no-precision")
    report = json.loads((tmp_path / "small-adjusted" / "report.json").read_text())
    assert (code, report["status"], report["iterations"]) == (1, "interrupted", 3)
    assert "has the last accepted unknowns" in out
    assert report["vtPv"] < report["vtPv_at_start"]


def test_ctrl_c_before_an_accepted_step_writes_nothing(run, folder, tmp_path, monkeypatch):
    def interrupted(block, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(adjusting, "adjust", interrupted)
    code, out, err = run("adjust", folder)
    assert (code, out) == (130, "") and "no results are written" in err
    assert not list(tmp_path.iterdir())


def full(*_):
    raise OSError(28, "No space left on device")


def test_results_that_cannot_be_written_are_kept_elsewhere(run, folder, adjustment, tmp_path, monkeypatch):
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: adjustment)
    monkeypatch.setattr(adjusting, "write_report", full)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, out, err = run("adjust", folder)
    assert code == 3 and "No space left on device; the results were saved in" in err
    assert "sigma0" in out
    kept = Path(out.splitlines()[-1].removeprefix("Results: "))
    assert kept.parent == tmp_path and json.loads((kept / "report.json").read_text())["trustworthy"]
    monkeypatch.setattr(adjusting, "rescue", full)
    code, out, err = run("adjust", folder)
    assert (
        code == 3
        and "a temporary folder cannot be written either" in err
        and "sigma0" in out
        and "Results: not written" in out
    )


def test_a_report_that_fails_leaves_the_numbers(run, folder, adjustment, tmp_path, monkeypatch):
    def broken(*_):
        raise KeyError("a mistake in the report")

    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: adjustment)
    monkeypatch.setattr("jaxbundle.report.files.text_of", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, out, err = run("adjust", folder)
    assert code == 4 and "internal error (KeyError: 'a mistake in the report')" in err
    assert "please report it together with" in err and "Traceback" not in err
    (trace,) = tmp_path.glob("jaxbundle-error-*.txt")
    assert "Traceback" in trace.read_text() and "jaxbundle 0.1.0" in trace.read_text()
    (kept,) = tmp_path.glob("jaxbundle-results-*")
    assert "sigma0" in out and str(kept) in out
    with np.load(kept / "adjustment.npz") as arrays:
        np.testing.assert_array_equal(arrays["block.object_points"], adjustment.block.object_points)
    assert (kept / "points.csv").exists() and not (tmp_path / "small-adjusted").exists()


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), 4, "not enough memory"),
        (MemoryError(), 4, "not enough memory"),
        (ZeroDivisionError("of the program"), 4, "internal error (ZeroDivisionError: of the program)"),
        (PermissionError(13, "Permission denied", "x.csv"), 2, "x.csv"),
    ],
)
def test_whatever_goes_wrong_is_a_sentence(run, folder, tmp_path, monkeypatch, error, code, words):
    def broken(block, **options):
        raise error

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(adjusting, "adjust", broken)
    found, out, err = run("adjust", folder)
    assert (found, out) == (code, "") and words in err and "Traceback" not in err
    assert not (tmp_path / "small-adjusted").exists()


def test_the_largest_code_of_several_counts():
    assert max(codes.Code.NOT_TRUSTED, codes.Code.BAD_INPUT) == 2
    assert [code.value for code in codes.Code] == [0, 1, 2, 3, 4, 130]


def test_a_swallowed_signal_is_not_lost(monkeypatch):
    with Interruption() as stop:
        stop.begin()
        with pytest.raises(KeyboardInterrupt):
            stop._hear(signal.SIGINT, None)  # lost by whoever caught this
        with pytest.raises(KeyboardInterrupt):
            stop.step(accepted=True)
    with Interruption() as stop:
        stop.step(accepted=True)
        stop._hear(signal.SIGTERM, None)  # marks only: there is something to keep
        with pytest.raises(KeyboardInterrupt):
            stop.step(accepted=False)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


# a process that, after a Ctrl-C, is in one call of C for minutes, as XLA's compiler may be
DEAF = """
import hashlib, signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxbundle.cli.interruption import Interruption
with Interruption():
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_a_second_ctrl_c_ends_a_process_that_hears_nothing():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", DEAF]
    with subprocess.Popen(command, env=environment, stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stderr.readline() == "\n"
        assert process.stderr.readline() == "jaxbundle: stopping after this step; Ctrl-C again stops immediately\n"
        time.sleep(1.0)  # what comes within half a second is the same Ctrl-C
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=10) == 130 and time.monotonic() - start < 5


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), {"method": "levenberg-marquardt", "max_iterations": 200, "precision": True, "engine": "block"}),
        (("--method", "gauss-newton", "--max-iterations", "7"), {"method": "gauss-newton", "max_iterations": 7}),
        (("--engine", "jaxopt", "--no-precision"), {"engine": "jaxopt", "precision": False}),
    ],
)
def test_options_of_the_solve(run, folder, adjustment, monkeypatch, options, expected):
    given = {}
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: given.update(options) or adjustment)
    assert run("adjust", folder, *options)[0] == 0
    assert {name: getattr(given["options"], name) for name in expected} == expected


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), None),
        (("--robust", "huber"), Huber()),
        (("--robust", "tukey", "--robust-limit", "5"), Tukey(limit=5.0)),
    ],
)
def test_robust_options(run, folder, adjustment, monkeypatch, options, expected):
    given = {}
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: given.update(options) or adjustment)
    assert run("adjust", folder, *options)[0] == 0
    robust = given["options"].robust
    assert type(robust) is type(expected)
    assert robust is None or robust.limit == expected.limit


@pytest.mark.parametrize(
    ("options", "kind", "limit"),
    [
        ((), AngleRule, 1e-8),
        (("--limit", "1e-6"), AngleRule, 1e-6),
        (("--stop", "points", "--limit", "0.001"), PointRule, 0.001),
        (("--stop", "parallax", "--limit", "1e-6"), ParallaxRule, 1e-6),
        (("--stop", "unknown", "--limit", "1e-4"), UnknownRule, 1e-4),
    ],
)
def test_stopping_rules(run, folder, adjustment, monkeypatch, options, kind, limit):
    given = {}
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: given.update(options) or adjustment)
    assert run("adjust", folder, *options)[0] == 0
    assert type(given["options"].stop) is kind and given["options"].stop.limit == limit


def test_unknowns_of_the_stopping_rule(run, folder, adjustment, monkeypatch):
    given = {}
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: given.update(options) or adjustment)
    options = ("--stop", "unknown", "--limit", "1e-6", "--unknown", "1_01:X0", "--unknown", "camera:K1")
    assert run("adjust", folder, *options)[0] == 0
    assert given["options"].stop.names == (("1_01", "X0"), ("camera", "K1"))


def test_interior_can_be_held(run, folder, adjustment, monkeypatch):
    given = []
    monkeypatch.setattr(adjusting, "adjust", lambda block, **options: given.append(block) or adjustment)
    assert run("adjust", folder)[0] == run("adjust", folder, "--hold-interior")[0] == 0
    assert [int(block.structure.interior_free.sum()) for block in given] == [5, 0]
    assert given[1].redundancy == given[0].redundancy + 5


def test_a_block_too_large_for_an_engine_is_2(run, folder, monkeypatch):
    def refused(block, **options):
        raise ValueError("limited to 3000 unknowns")

    monkeypatch.setattr(adjusting, "adjust", refused)
    code, out, err = run("adjust", folder, "--engine", "jaxopt")
    assert (code, out) == (2, "") and "limited to 3000 unknowns" in err and "Traceback" not in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "newton"), "'newton' is not one of"),
        (
            ("--method", "strips", "--polynomials", "conformal", "--degree", "3"),
            "--polynomials conformal require degree 2",
        ),
        (("--method", "models", "--stop", "parallax", "--limit", "1"), "require the bundle"),
        (("--stop", "points"), "--stop points needs a --limit"),
        (("--robust-limit", "3"), "--robust-limit requires --robust"),
        (("--robust", "huber", "--robust-limit", "0"), "--robust-limit 0.0 is not positive"),
        (("--robust", "huber", "--checkpoint", "state"), "--checkpoint is not supported together with --robust"),
        (("--robust", "l1"), "'l1' is not one of"),
        (("--limit", "0"), "--limit 0.0 is not positive"),
        (("--limit", "nan"), "--limit nan is not positive"),
        (("--unknown", "1_01:X0"), "--unknown requires --stop unknown"),
        (("--stop", "unknown", "--limit", "1", "--unknown", "X0"), "--unknown X0 is not NAME:ELEMENT"),
        (("--stop", "unknown", "--limit", "1", "--unknown", "9_09:X0"), "no unknown X0 of 9_09"),
        (("--max-iterations", "0"), "greater than or equal to 1"),
    ],
)
def test_wrong_options_are_2(run, folder, tmp_path, options, message):
    code, out, err = run("adjust", folder, *options)
    assert (code, out) == (2, "")
    assert message in " ".join(err.replace("│", " ").split()) and "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_bad_input_is_2(run, folder, tmp_path):
    code, out, err = run("adjust", "nowhere")
    assert (code, out) == (2, "") and err.startswith("jaxbundle: 1 problem in the block:\n  nowhere does not exist")
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    with (broken / "rays.csv").open("a") as rays:
        rays.write("1_01,20,x,1,,\n9_09,20,1,1,,\n")
    code, out, err = run("adjust", broken)
    assert (code, out) == (2, "") and err.startswith("jaxbundle: 2 problems in the block:\n")
    assert not (tmp_path / "broken-adjusted").exists()


def test_a_block_folder_is_no_place_for_results(run, folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    code, out, err = run("adjust", folder, "--out", folder)
    assert (code, out) == (2, "") and "which no adjustment wrote; give another folder" in err
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_convert(run, folder, tmp_path, shared_data):
    code, out, _ = run("convert", folder, "copy")
    assert (code, out) == (0, "Block 2 x 4 images: copy\n")
    assert read(tmp_path / "copy").structure.image_names == read(folder).structure.image_names
    assert run("convert", folder, "copy")[0] == 2  # it exists
    code, _, err = run("convert", folder, "copy.txt")
    assert code == 2 and "BAL files support the model 'bal' only" in err and not (tmp_path / "copy.txt").exists()
    bal = shared_data / "bal" / "ladybug-49-shrink-1800.txt"
    assert run("convert", bal, "folder")[0] == run("convert", "folder", "again.txt")[0] == 0
    assert read(tmp_path / "again.txt").structure.point_names == read(bal).structure.point_names


def test_check_partials(run):
    code, out, err = run("check-partials", "--draws", 50)
    assert (code, err) == (0, "") and "All 18 partials are correct" in out


def test_demo_runs(run, tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "simulations", lambda: {"strip": small_block()})
    code, out, err = run("demo", "--out", "results")
    assert (code, err) == (0, "")
    assert "Adjusted - true values, in standard deviations" in out and "within 2 sd" in out
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == ["strip", "strip-adjusted"]


def test_demo_simulates_a_strip_and_a_block():
    blocks = {name: simulation.block.structure for name, simulation in demo.simulations().items()}
    assert {name: len(structure.image_names) for name, structure in blocks.items()} == {"strip": 8, "block": 24}


def test_progress_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # makes a terminal of any stream
    monkeypatch.setenv("COLUMNS", "120")
    lines = ProgressLines()
    with lines.phase("adjusting"):
        lines.iteration(Progress(1, 12.5, 1e-4, 0.1, True, 1.5))
        lines.iteration(Progress(2, 12.5, 2e-4, math.nan, False, 1.5))
    out, err = capsys.readouterr()
    assert out == "" and HEADER in err and "rejected" in err and "adjusting" in err and "nan" not in err


def test_phases_and_the_time_left_on_a_terminal(monkeypatch, capsys):
    """An iteration of 20 s whose steps shrink tenfold: at 1e-4 the limit of 1e-8 is four iterations away."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "160")
    clock = iter(range(0, 10_000, 20))
    monkeypatch.setattr(progress.time, "perf_counter", lambda: float(next(clock)))
    lines = ProgressLines()
    lines.rule, told = AngleRule(), []
    with lines.phase("adjusting"):
        for phase in ("planning", "compiling", "iterating"):
            lines.begins(phase)
        for k in range(1, 5):
            lines.iteration(Progress(k, 12.5, 1e-4, 10.0**-k, True, 1.5))
            told.append(str(lines._status and lines._status.status))
        lines.begins("standard deviations")
    err = capsys.readouterr().err
    assert told[-1] == "iterating, about 80 s left (4 iterations of 20.0 s), then standard deviations"
    for phase in ("planning", "compiling", "iterating", "standard deviations"):
        assert f"{phase}: " in err


def test_time_left():
    assert progress.iterations_left([1.0, 0.1, 0.2], AngleRule()) == 21
    assert progress.iterations_left([0.1, 0.2], AngleRule()) is None
    assert progress.iterations_left([0.1], AngleRule()) is None
    assert progress.iterations_left([1.0, 0.1], PointRule(1e-3)) is None
    assert progress.iterations_left([1.0, 1e-9], AngleRule()) == 1
    assert progress.told_left(3, 1.0) == "" and progress.told_left(None, 100.0) == ""
    assert progress.told_left(30, 20.0).startswith(", about 10 min left (30 iterations")


def test_phases_are_told_in_their_order():
    told = []
    adjust(small_block().block, phase=told.append)
    assert told == ["planning", "compiling", "iterating", "standard deviations"]
