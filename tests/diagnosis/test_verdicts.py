"""From a folder to its verdict: the mistakes people make, and small blocks that were once judged wrongly.

A row says what the whole way (read, adjust, findings) must come to: whether the result may be used, what is found, and
who is named first. What the reader refuses by itself stands in test_mistakes_reader.
"""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np
import pytest
from cases.mistaken_folders import made

import jaxbundle as jb
from jaxbundle.block.changes import with_findings
from jaxbundle.block.depths import behind
from jaxbundle.block.findings import Finding, Kind, Severity

SIGMA0 = 1.0744681852  # of the block that the mistakes are made in


class Verdict(NamedTuple):
    """`usable`: exit code 0. `kinds`: found among others; `culprit`: names of the first subject of the first of them;
    `component`: its component. `sigma0`: None where it does not matter."""

    usable: bool
    kinds: tuple[Kind, ...] = ()
    culprit: tuple[str, ...] | None = None
    component: str | None = None
    sigma0: float | None = None


RIGHT = Verdict(True, sigma0=SIGMA0)
REPAIRED = Verdict(True, (Kind.REPAIRED,), sigma0=SIGMA0)
MISTAKES: dict[str, Verdict] = {
    "a00": RIGHT,
    "a03": RIGHT,
    "a04": RIGHT,
    "a05": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a06": Verdict(False, (Kind.FORMAT,), ("scan",)),
    "a07": Verdict(False, (Kind.FORMAT,), (), "y"),
    "a08": Verdict(False, (Kind.FORMAT,), ("scan",)),
    "a09": Verdict(False, (Kind.FORMAT,), ("scan",)),
    "a18": Verdict(True, (Kind.UNUSED,), ("371",)),
    "a20": Verdict(False, (Kind.CONTROL_SYSTEM,)),
    "a21": Verdict(False, (Kind.CONTROL_SYSTEM,)),
    "a22": Verdict(False, (Kind.INTERIOR,), ("scan",), "principal_distance"),
    "a23": Verdict(False, (Kind.INTERIOR,), ("scan",), "principal_distance"),
    "a24": Verdict(False, (Kind.INTERIOR,), ("scan",), "principal_distance"),
    "a26": Verdict(False, (Kind.INTERIOR,), ("scan",)),
    "a27": Verdict(False, (Kind.CONTROL_SYSTEM,)),
    "a28": Verdict(True, (Kind.SIGMAS,)),
    "a29": Verdict(True, (Kind.START, Kind.REPAIRED), ("8936",), sigma0=SIGMA0),
    "a30": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a31": RIGHT,
    "a32": RIGHT,
    "a35": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a36": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a42": Verdict(True, (Kind.SUSPECT,), ("422",), "X"),
    "a43": Verdict(False, (Kind.CONTROL_SYSTEM, Kind.SUSPECT)),
    "a44": Verdict(True, (Kind.SUSPECT,), ("422",), "Z"),
    "a47": Verdict(False, (Kind.CONTROL_SYSTEM,)),
    "a48": Verdict(False, (Kind.FORMAT,), ("scan",)),
    "a49": Verdict(False, (Kind.SIGMA0,)),
    "a50": Verdict(True, (Kind.SUSPECT,), ("8811", "65819")),
    "a51": Verdict(False, (Kind.SUSPECT,), ("8937", "65297")),
    "a57": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a58": REPAIRED,
    "a61": RIGHT,
    "a63": Verdict(True, (Kind.WEAK, Kind.INSIGNIFICANT), ("scan",), "principal_distance"),
    "a71": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=SIGMA0),
    "a72": Verdict(False, (Kind.FORMAT,), (), "x"),
}
BLOCKS: dict[str, Verdict] = {
    "01-gcp-axes-swapped/cured": Verdict(True, sigma0=0.9604),
    "01-gcp-axes-swapped/fixed": Verdict(False, (Kind.CONTROL_SYSTEM, Kind.SUSPECT), ("GCP3",)),
    "01-gcp-axes-swapped/weighted": Verdict(False, (Kind.CONTROL_SYSTEM, Kind.SUSPECT), ("GCP3",)),
    "01-gcp-axes-swapped/weighted-no-approx": Verdict(False, (Kind.CONTROL_SYSTEM, Kind.SUSPECT), ("GCP3",)),
    "01-gcp-axes-swapped/pair": Verdict(False, (Kind.CONTROL_SYSTEM, Kind.SUSPECT), ("GCP1",)),
    "04-gcps-on-a-line/line-with-noise": Verdict(False, (Kind.IMPRECISE, Kind.NOT_CONVERGED), ("GCP1",)),
    "04-gcps-on-a-line/two-close": Verdict(True, sigma0=0.9598),
    "06-no-parallax/diverging-2px": Verdict(False, (Kind.UNDETERMINED,), ("FAR",)),
    "06-no-parallax/diverging-60px": Verdict(False, (Kind.UNDETERMINED,), ("FAR",)),
    "06-no-parallax/far-converging": Verdict(True, (Kind.WEAK,), ("FAR",)),
    "06-no-parallax/no-approx": Verdict(False, (Kind.UNDETERMINED,), ("FAR",)),
    "06-no-parallax/parallel": Verdict(True, (Kind.WEAK,), ("FAR",)),
    "10-vertical-datum/plain": Verdict(False, (Kind.SYSTEMATIC,)),
    "10-vertical-datum/with-shift": Verdict(True, (Kind.INSIGNIFICANT,), sigma0=1.03),
    "12-boresight/kappa-180": Verdict(True, (Kind.WEAK,), ("boresight omega of imu",), sigma0=0.935),
    "12-boresight/unknown": Verdict(True, sigma0=0.935),
    "12-boresight/wrong-sign": Verdict(False, (Kind.SYSTEMATIC,)),
    "14-disconnected/control-in-both": Verdict(True, sigma0=0.9615),
    "14-disconnected/control-in-one": Verdict(False, (Kind.PARTS,), ("s1_01",)),
    "14-disconnected/inner": Verdict(False, (Kind.PARTS,), ("s1_01",)),
    "14-disconnected/no-control": Verdict(False, (Kind.PARTS,), ("s1_01",)),
    "22-behind-the-camera/cameras-below-ground": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "22-behind-the-camera/free-mirrored": Verdict(True, (Kind.REPAIRED,)),
    "22-behind-the-camera/looking-up": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "22-behind-the-camera/one-point-above": Verdict(True, (Kind.REPAIRED,), ("t0003",), sigma0=0.9383),
    "22-behind-the-camera/points-above-cameras": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "22-behind-the-camera/v-axis-up": Verdict(False, (Kind.FORMAT,), (), "y"),
    "22-behind-the-camera/x-y-exchanged": Verdict(False, (Kind.FORMAT,), ("cam",)),
    "27-equal-start/mean": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.9383),
    "27-equal-start/mean-nopoints": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "27-equal-start/zero-nopoints": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "27-equal-start/points-zero": Verdict(True, (Kind.REPAIRED,), sigma0=0.9383),
    "27-equal-start/zero": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.9383),
    "33-mirrored-solution/flat-control-from-below": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.9406),
    "33-mirrored-solution/flat-control-sign-of-Z": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.9406),
    "33-mirrored-solution/free-inverted": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.948),
    "33-mirrored-solution/free-inverted-inner": Verdict(True, (Kind.START, Kind.REPAIRED), sigma0=0.948),
    "35-plan-as-approximation/gcp-plan": Verdict(True, sigma0=0.9626),
    "35-plan-as-approximation/plan": Verdict(True, sigma0=1.032),
    "35-plan-as-approximation/true-approx": Verdict(True, sigma0=1.032),
    "36-which-ray/b": Verdict(False, (Kind.SUSPECT,), ("s2_03", "t0905")),
    "fuzz/solve/approx-below-ground-noprec": Verdict(True, (Kind.START, Kind.REPAIRED)),
    "fuzz/solve/approx-centres-10000": Verdict(True, (Kind.REPAIRED,)),
    "fuzz/solve/approx-omega-180": Verdict(True, (Kind.REPAIRED,)),
    "fuzz/solve/approx-one-point-in-centre": Verdict(True, (Kind.REPAIRED,), ("p5",)),
    "fuzz/solve/connected-by-one-point-noprec": Verdict(False, (Kind.PARTS,), ("i0",)),
}
REFUSED = (  # by the datum or by the start; the words speak of what is wrong
    ("04-gcps-on-a-line/line", "these lie on one line"),
    ("fuzz/solve/control-collinear-3", "these lie on one line"),
    ("fuzz/solve/strip-control-on-line", "these lie on one line"),
)
OFTEN = ("a07", "a29", "a44", "a50", "a51")  # the others are run on demand
OFTEN_BLOCKS = (
    "01-gcp-axes-swapped/weighted",
    "14-disconnected/control-in-one",
    "22-behind-the-camera/one-point-above",
    "33-mirrored-solution/flat-control-from-below",
    "35-plan-as-approximation/gcp-plan",
)


def cases(table: dict[str, Verdict], often: tuple[str, ...]) -> list:
    return [
        pytest.param(name, verdict, marks=() if name in often else pytest.mark.thorough, id=name)
        for name, verdict in table.items()
    ]


def judge(verdict: Verdict, folder: Path) -> None:
    """Goes the whole way, and holds its end against the verdict."""
    block = jb.read(folder)
    result = jb.adjust(block)
    found = jb.findings(result, block)
    words = [f"{f.severity.label} {f.kind.name}: {f.words}" for f in found]
    assert result.trustworthy == verdict.usable, words
    assert result.trustworthy == (not any(f.severity is Severity.FAILED for f in found)), words
    assert ("must not be used" in result.summary(found)) == any(
        f.severity is Severity.FAILED and f.kind is not Kind.NOT_CONVERGED for f in found
    )
    kinds = [finding.kind for finding in found]
    assert set(verdict.kinds) <= set(kinds), words
    if verdict.kinds:
        first = found[kinds.index(verdict.kinds[0])]
        assert first.what and (first.cure or first.severity is Severity.NOTE)
        if verdict.culprit is not None:
            assert first.subjects[0].names == verdict.culprit, words
        if verdict.component is not None:
            assert first.subjects[0].component == verdict.component, words
    if verdict.usable:
        assert not behind(result.block).any(), words
        told = Kind.SUSPECT in verdict.kinds or Kind.SYSTEMATIC in verdict.kinds
        assert told or _blamed(found) <= {("control", "410")}, words
    if verdict.sigma0 is not None:
        assert float(result.sigma0) == pytest.approx(verdict.sigma0, rel=1e-3 if verdict.sigma0 != SIGMA0 else 1e-6)


def _blamed(found: tuple[Finding, ...]) -> set[tuple[str, ...]]:
    """Whom the residuals accuse. Control point 410 of the real block disagrees by 4.8 standard deviations in Y."""
    culprits = (f for f in found if f.kind in (Kind.SUSPECT, Kind.SYSTEMATIC))
    return {(subject.table, *subject.names) for finding in culprits for subject in finding.subjects}


@pytest.mark.parametrize(("mistake", "verdict"), cases(MISTAKES, OFTEN))
def test_mistakes(shared_data: Path, tmp_path: Path, mistake: str, verdict: Verdict) -> None:
    judge(verdict, made(shared_data, mistake, tmp_path))


@pytest.mark.parametrize(("case", "verdict"), cases(BLOCKS, OFTEN_BLOCKS))
def test_blocks_of_known_truth(shared_data: Path, case: str, verdict: Verdict) -> None:
    judge(verdict, shared_data / "cases" / case)


@pytest.mark.parametrize(("case", "words"), REFUSED)
def test_refused(shared_data: Path, case: str, words: str) -> None:
    with pytest.raises(jb.BlockError, match=words):
        jb.adjust(jb.read(shared_data / "cases" / case), precision=False)


def control_error(block: jb.Block, size: float) -> tuple[jb.Block, str]:
    """The block with a wrong height of its first control point, and the point's name."""
    number = next(k for k, group in enumerate(block.groups) if group.structure.kind is jb.observations.CONTROL)
    group = block.groups[number]
    wrong = eqx.tree_at(lambda b: b.groups[number].values, block, group.values.at[0, 2].add(size))
    return wrong, block.structure.point_names[group.structure.indices[0, 0]]


@pytest.mark.thorough
@pytest.mark.parametrize("size", [0.3, 1.0, 10.0, 100.0, 1000.0])
def test_a_wrong_height_is_named_whatever_its_size(shared_data: Path, size: float) -> None:
    """By its residual where the adjustment ends well, by the start and by what cures it where it does not."""
    right = jb.read(shared_data / "cases" / "01-gcp-axes-swapped" / "cured", check_start=False)
    wrong, name = control_error(right, size)
    start = with_findings(*jb.blocks.prepared(wrong))
    found = jb.findings(jb.adjust(start), start)
    named = [f for f in found if f.kind in (Kind.CONTROL_SYSTEM, Kind.SUSPECT)]
    assert named and all(f.subjects[0].names == (name,) for f in named), [f.words for f in found]
    sizes = np.array([abs(f.size) for f in named])
    assert np.abs(sizes - size).min() < max(0.15 * size, 0.2)
