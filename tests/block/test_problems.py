"""Problems as they are shown: nothing that a terminal would obey, nothing without end."""

import pytest
from hypothesis import given, settings, strategies as st

from jaxbundle.block.problems import LONGEST, SHOWN, BlockError, Problem, is_hidden, printable, shown


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("point 7", "point 7"),
        ("Brücke é １", "Brücke é １"),
        ("a\x00b\x1b[31m", "a\\x00b\\x1b[31m"),
        ("a\nb\tc\r", "a\\nb\\tc\\r"),
        ("a\u202eb\u2066c\ufeff\u2028", "a\\u202eb\\u2066c\\ufeff\\u2028"),
        ("ab\u00a0c", "ab\u00a0c"),
    ],
)
def test_printable(text: str, expected: str) -> None:
    assert printable(text) == expected


@settings(max_examples=50)
@given(st.text(max_size=200))
def test_shown(text: str) -> None:
    """As it is, or its beginning and its length."""
    said = shown(text)
    assert not any(map(is_hidden, said))
    assert said == printable(text) if len(text) <= LONGEST else said.endswith(f"... ({len(text)} characters)")


def test_error_of_many_problems() -> None:
    error = BlockError([Problem(f"ray {k} is\x1b wrong", "drop it", "rays", k) for k in range(SHOWN + 5)])
    assert len(error.problems) == len(error.lines) == SHOWN + 5
    assert str(error).startswith("205 problems in the block:\n  rays, row 0: ray 0 is\\x1b wrong; drop it\n")
    assert str(error).endswith("\n  ... and 5 more")
    assert str(BlockError([Problem("it is wrong", "drop it")])) == "1 problem in the block:\n  it is wrong; drop it"
