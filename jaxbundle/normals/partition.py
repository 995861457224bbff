"""How unknowns and observations lie on the devices: tiles parted, all else everywhere."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jax.sharding import PartitionSpec

from jaxbundle.normals.arrange import Arranged, Problem
from jaxbundle.normals.cells import Tiles
from jaxbundle.numerics.devices import AXIS

EVERYWHERE: Any = PartitionSpec()
OF_TILES: Any = PartitionSpec(None, AXIS)  # of arrays (3, tile, column)


def unknown_parts(unknowns: Arranged) -> Arranged:
    """Of the unknowns."""
    return Arranged(everywhere(unknowns.images), OF_TILES)


def problem_parts(p: Problem) -> Problem:
    """Of the observations."""
    tiles = tuple(_by_device(t, lambda _: PartitionSpec(AXIS), lambda _: EVERYWHERE) for t in p.tiles)
    return dataclasses.replace(everywhere(p), tiles=tiles)


def everywhere(tree: Any) -> Any:
    """Of what all devices have."""
    return jax.tree.map(lambda _: EVERYWHERE, tree)


def local_tiles(tiles: tuple[Tiles, ...]) -> tuple[Tiles, ...]:
    """A device's own tiles: the leading axis, of length 1 there, taken off."""
    return tuple(_by_device(t, lambda x: x[0], lambda pair: pair) for t in tiles)


def _by_device(tiles: Tiles, own: Callable, common: Callable) -> Tiles:
    """`own` of what every device has for itself, `common` of the list of pairs, which all have in common."""
    mapped = jax.tree.map(own, tiles)
    if tiles.products is None:
        return mapped
    return eqx.tree_at(lambda t: t.products.pair, mapped, common(tiles.products.pair))
