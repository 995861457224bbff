"""Work in threads on all cores."""

import numpy as np
import pytest

from jaxbundle.numerics.devices import on_cores


def test_results_come_in_the_order_of_the_items():
    assert list(on_cores(lambda x: x**2, range(20))) == [x**2 for x in range(20)]
    assert list(on_cores(lambda x: x, [])) == []


def test_threads_have_the_settings_of_the_caller():
    """Without them, a division by zero that the caller allows is a warning, and an error in this suite."""
    with np.errstate(divide="ignore"):
        assert list(on_cores(lambda x: np.float64(1.0) / np.float64(x), [0.0] * 3)) == [np.inf] * 3


def test_an_error_ends_the_work():
    def reciprocal(x: int) -> float:
        return 1 / x

    found = on_cores(reciprocal, [1, 0, *range(1, 100)])
    assert next(found) == 1.0
    with pytest.raises(ZeroDivisionError):
        list(found)
