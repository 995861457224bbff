"""Names that match but for a little: what matches, under which change, and what does not."""

import pytest
from hypothesis import given, settings, strategies as st

from jaxbundle.io.near_names import nearest, slip

KNOWN = ("317", "375", "403", "1000", "tower", "Church 2", "0042")


@pytest.mark.parametrize(
    ("unknown", "pairs", "words"),
    [
        (["GCP317", "GCP375"], {"GCP317": "317", "GCP375": "375"}, "without 'GCP'"),
        (["317.0", "403.0"], {"317.0": "317", "403.0": "403"}, "without the decimal '.0'"),
        (["0317"], {"0317": "317"}, "without leading zeros"),
        (["42"], {"42": "0042"}, "without leading zeros"),
        (["TOWER", "church2"], {"TOWER": "tower", "church2": "Church 2"}, "except for upper and lower case or blanks"),
        (["317.tif", "403.tif", "9.tif"], {"317.tif": "317", "403.tif": "403"}, "without '.tif'"),
        (["images/317.JPG", "b/375.png"], {"images/317.JPG": "317", "b/375.png": "375"}, "without the extension"),
    ],
)
def test_changes(unknown: list[str], pairs: dict[str, str], words: str) -> None:
    match = nearest(unknown, KNOWN)
    assert match is not None
    assert (match.pairs, match.words, match.of) == (pairs, words, len(unknown))


def test_prefix_of_the_known_names() -> None:
    match = nearest(["317", "375"], ["GCP317", "GCP375", "GCP403"])
    assert match is not None and match.pairs == {"317": "GCP317", "375": "GCP375"}
    assert match.words == "without 'GCP' of the known names"


def test_what_is_ambiguous_does_not_match() -> None:
    assert nearest(["00317"], ["317", "0317"]) is None
    assert nearest(["x"], []) is None
    assert nearest(["completely", "different"], KNOWN) is None


def test_few_of_many_match_by_chance() -> None:
    assert nearest([f"P{k}" for k in range(10, 30)] + ["P317"], KNOWN) is None


@pytest.mark.parametrize(
    ("name", "meant"),
    [("371", "317"), ("3177", "317"), ("towr", "tower"), ("towre", "tower"), ("31", ""), ("999", ""), ("317", "")],
)
def test_slips(name: str, meant: str) -> None:
    assert slip(name, KNOWN) == meant


def test_two_likely_names_are_none() -> None:
    assert slip("101", ["111", "102"]) == ""
    assert slip("110", ["101", "111"]) == "101"


NAMES = st.lists(st.text(max_size=8), max_size=8)


@settings(max_examples=40)
@given(NAMES, NAMES)
def test_any_names(unknown: list[str], known: list[str]) -> None:
    """A match pairs unknown names with known ones, and can be told."""
    match = nearest(unknown, known)
    if match:
        assert match.pairs.keys() <= set(unknown) and set(match.pairs.values()) <= set(known)
        assert str(match).endswith("?")
    for name in unknown:
        assert slip(name, known) in ("", *known)
