"""Exchanged names of control in a block of four control points: too few to hold the wrong ones back."""

import pytest

from jaxbundle.block.findings import Kind, Severity
from jaxbundle.cli import pages
from jaxbundle.diagnosis.adjusted import findings
from jaxbundle.io import read
from jaxbundle.solve.adjust import adjust


@pytest.mark.parametrize(
    ("new_names", "words"),
    [
        ("BACD", "control points A, B are exchanged;"),
        ("BCDA", "the coordinates given for A belong to D"),
    ],
)
def test_exchanged_names_are_named(tmp_path, new_names, words):
    folder = tmp_path / "quarry"
    pages.new(folder)
    file = folder / "control.csv"
    header, *rows = file.read_text().splitlines()
    rows = [
        ",".join([name, *row.split(",")[1:]]) if row.startswith(old) else row
        for old, name, row in zip("ABCD", new_names, rows, strict=False)
    ] + rows[4:]
    file.write_text("\n".join([header, *rows]) + "\n")
    block = read(folder)
    result = adjust(block)
    assert not result.trustworthy
    named = [finding for finding in findings(result, block) if finding.kind is Kind.SUSPECT]
    assert named[0].severity is Severity.FAILED
    wrong = {old for old, new in zip("ABCD", new_names, strict=True) if old != new}
    assert {subject.names[0] for subject in named[0].subjects} == wrong
    assert words in named[0].what
