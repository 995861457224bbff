"""Control whose X and Y are exchanged mirrors the block: over flat ground the residuals hardly show it."""

import polars as pl

import jaxbundle as jb
from jaxbundle.block.findings import Kind
from jaxbundle.cli import pages


def test_cameras_that_are_turned_upside_down_by_the_control_are_not_trusted(tmp_path):
    pages.new(tmp_path / "quarry")
    file = tmp_path / "quarry" / "control.csv"
    pl.read_csv(file, comment_prefix="#").rename({"X": "Y", "Y": "X"}).write_csv(file)
    block = jb.read(tmp_path / "quarry")
    (found,) = [finding for finding in block.structure.findings if finding.kind is Kind.MIRRORED]
    assert {subject.names[0] for subject in found.subjects} == {"11", "12", "21", "22"}
    assert not jb.adjust(block).trustworthy
