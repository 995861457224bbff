"""Numbers of the host: put on devices, arranged by numpy or traced, given to compiled functions."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from jaxbundle.numerics.compilation import Compiled
from jaxbundle.numerics.host import on_device, on_host, on_host_or_traced, selected, tree_with


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


@on_host_or_traced
def _roots_and_module(xp, values):
    return {"roots": xp.sqrt(values["x"]), "numpy": xp is np}


def test_numbers_are_computed_by_numpy_and_tracers_by_jax():
    x = jnp.array([1.0, 4.0])
    found = _roots_and_module({"x": x})
    assert found["numpy"] and isinstance(found["roots"], jax.Array)
    assert not jax.jit(lambda x: _roots_and_module({"x": x})["numpy"])(x)
    np.testing.assert_array_equal(jax.jit(lambda x: _roots_and_module({"x": x})["roots"])(x), found["roots"])
    slopes = jax.jacrev(lambda x: _roots_and_module({"x": x})["roots"])(x)
    np.testing.assert_allclose(slopes, np.diag([0.5, 0.25]))


def test_other_objects_pass_through():
    """A plan has no leaves for JAX; whole numbers of a shape remain whole numbers on the way to the host."""
    plan = object()
    assert on_host((plan, 3, "name")) == (plan, 3, "name")
    assert on_device((plan, "name")) == (plan, "name")


def test_selected_members():
    tree = {"x": jnp.arange(6.0).reshape(3, 2), "y": np.arange(3)}
    found = selected(tree, np.array([True, False, True]))
    np.testing.assert_array_equal(found["x"], [[0.0, 1.0], [4.0, 5.0]])
    np.testing.assert_array_equal(found["y"], [0, 2])
    assert all(isinstance(x, jax.Array) for x in found.values())


def test_a_tree_with_new_arrays():
    found = tree_with(lambda t: (t["x"], t["y"]), {"x": jnp.zeros(2), "y": jnp.ones(1), "z": "name"}, (np.ones(2), 3.0))
    assert all(isinstance(found[name], jax.Array) for name in "xy") and found["z"] == "name"
    assert found["x"].sum() == 2.0 and found["y"] == 3.0


def test_a_compiled_function_takes_numpy_arrays():
    """By the program for arrays of JAX."""
    traced = []

    @Compiled
    def double(x, factor: int):
        traced.append(x)
        return x * factor

    for x in (jnp.arange(3.0), np.arange(3.0)):
        np.testing.assert_array_equal(double(x, 2, optimised=False), [0.0, 2.0, 4.0])
    assert len(traced) == 1
