"""Work in threads on all cores, and numbers that go to the devices."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.numerics.devices import on_cores
from jaxbundle.numerics.host import on_device


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


def test_only_numbers_are_put_on_a_device():
    """Arrays of JAX and tracers are themselves; the tree keeps its shape."""
    here = jnp.arange(3.0)
    tree = {"here": here, "numbers": (np.arange(2), 1.5, True), "nothing": None}
    there = on_device(tree)
    assert there["here"] is here and there["nothing"] is None
    assert all(isinstance(x, jax.Array) for x in there["numbers"])
    assert [x.dtype.name for x in there["numbers"]] == ["int64", "float64", "bool"]
    assert float(jax.jit(lambda x: on_device((x, 2.0))[0])(3.0)) == 3.0
    assert on_device(()) == ()
    for one, two in itertools.combinations(on_device([np.zeros(2)] * 3), 2):
        np.testing.assert_array_equal(one, two)
