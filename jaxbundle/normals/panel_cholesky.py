"""Block-sparse Cholesky factorisation of the reduced matrix on its tiles, A = L L^T.

Factorisation, column J with the panels R below it, with C_J = L_JJ^-1 stored instead of L_JJ:

    L_RJ = A_RJ C_J^T,     A_AB <- A_AB - L_AJ L_BJ^T     A >= B in R

Substitution:   y_J = C_J r_J,  r_R <- r_R - L_RJ y_J;     x_J = C_J^T (y_J - L_RJ^T x_R), last column first.

Inverse on the pattern of L, last column first (Takahashi, Fagan & Chen 1973, in blocks), with K = L_RJ C_J:

    Z_RJ = -Z_RR K,        Z_JJ = C_J^T C_J - K^T Z_RJ

With two devices, each has the columns of one end of the band; the tiles of the separator are summed over the devices,
and then both do the same.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxbundle.normals.cholesky import inverse_factor
from jaxbundle.normals.plan.panel_lists import PanelColumns, PanelLists
from jaxbundle.normals.problem import AbstractImageFactor

Tiles = Float[Array, "tile b b"]
Sides = Float[Array, "panel b k"]


class _Part(NamedTuple):
    """Lists of this device, numbers of panels and tiles of its end, and whether it owns the separator."""

    ends: PanelColumns | None
    separator: PanelColumns
    position: Int[Array, " image"]
    pair_place: Int[Array, "pair 3"]
    end_tiles: int
    end_panels: int
    panels: int
    leads: Bool[Array, ""]


class PanelCholesky(AbstractImageFactor[Tiles]):
    """The sparse factorisation on the tiles of `lists`; the factor are the tiles of this device.

    `axis`: of the devices, None for one.
    """

    lists: PanelLists
    axis: str | None = eqx.field(static=True)

    def factorise(self, pairs: Float[Array, "pair d d"]) -> Tiles:
        part = self._part()
        tiles, empty = _assemble(part, pairs), _empty(part, pairs.shape[1])
        if part.ends is not None:
            tiles = _factorise(tiles, empty, part.ends, 0, 0)
            tiles = tiles.at[part.end_tiles :].set(self._sum(tiles[part.end_tiles :]))
        return _factorise(tiles, empty, part.separator, part.end_tiles, part.end_panels)

    def pivots(self, factor: Tiles, images: int, d: int) -> Float[Array, "image d"]:
        part = self._part()
        panel = jnp.arange(part.panels)
        tile = jnp.where(panel < part.end_panels, panel, panel - part.end_panels + part.end_tiles)
        inverse = jnp.diagonal(factor, axis1=1, axis2=2).at[tile].get(mode="fill", fill_value=1.0)
        shares = 1 / inverse**2
        return self._to_images(part, shares[..., None], d)[..., 0]

    def forward(self, factor: Tiles, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        part = self._part()
        y = _to_panels(part, right)
        if part.ends is not None:
            y = _own(part, y)
            y = _forward(factor, y, part.ends, 0, 0)
            y = y.at[part.end_panels :].set(self._sum(y[part.end_panels :]))
        y = _forward(factor, y, part.separator, part.end_tiles, part.end_panels)
        return self._to_images(part, y, right.shape[1])

    def backward(self, factor: Tiles, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        part = self._part()
        x = _backward(factor, _to_panels(part, right), part.separator, part.end_tiles, part.end_panels)
        if part.ends is not None:
            x = _backward(factor, x, part.ends, 0, 0)
        return self._to_images(part, x, right.shape[1])

    def selected_inverse(self, factor: Tiles, d: int) -> Float[Array, "pair d d"]:
        part = self._part()
        k = _unit_factor(factor, part.separator, part.end_tiles)
        if part.ends is not None:
            k = _unit_factor(k, part.ends, 0)
        z = _selected_inverse(k, jnp.zeros_like(k), part.separator, part.end_tiles)
        if part.ends is not None:
            z = _selected_inverse(k, z, part.ends, 0)
        q = factor.shape[1] // d
        tile, row, column = part.pair_place.T
        blocks = z.reshape(-1, q, d, q, d).at[tile, row, :, column].get(mode="fill", fill_value=0.0)
        return self._sum(blocks) if part.ends is not None else blocks

    def _part(self) -> _Part:
        device = jnp.asarray(0) if self.axis is None or self.lists.ends is None else lax.axis_index(self.axis)
        s = jax.tree.map(lambda x: x[jnp.minimum(device, x.shape[0] - 1)], self.lists)
        end_panels, end_tiles = (0, 0) if s.ends is None else _sizes(s.ends)
        panels = end_panels + _sizes(s.separator)[0]
        return _Part(s.ends, s.separator, s.position, s.pair_place, end_tiles, end_panels, panels, device == 0)

    def _sum(self, x: Array) -> Array:
        return lax.psum(x, self.axis)

    def _to_images(self, part: _Part, y: Sides, d: int) -> Float[Array, "image d k"]:
        if part.ends is not None:
            y = _own(part, y)
        x = y.reshape(-1, d, y.shape[2]).at[part.position].get(mode="fill", fill_value=0.0)
        return self._sum(x) if part.ends is not None else x


def _sizes(columns: PanelColumns) -> tuple[int, int]:
    """The padded numbers of panels and of tiles."""
    return columns.first_below.shape[0] - 1, columns.block.shape[0]


def _to_panels(part: _Part, right: Float[Array, "image d k"]) -> Sides:
    q = part.separator.block.shape[1]
    images, d, k = right.shape
    return jnp.zeros((part.panels * q, d, k)).at[part.position].set(right, mode="drop").reshape(-1, q * d, k)


def _own(part: _Part, y: Sides) -> Sides:
    """Sets the separator to 0 on all devices but the first."""
    end = jnp.arange(part.panels) < part.end_panels
    return jnp.where((end | part.leads)[:, None, None], y, 0.0)


def _empty(part: _Part, d: int) -> Float[Array, "panel b"]:
    """Mask with 1 in the rows of a panel without image."""
    q = part.separator.block.shape[1]
    empty = jnp.ones(part.panels * q).at[part.position].set(0.0, mode="drop")
    return jnp.repeat(empty, d).reshape(part.panels, q * d)


def _assemble(part: _Part, pairs: Float[Array, "pair d d"]) -> Tiles:
    """The blocks of the pairs at their positions."""
    block = part.separator.block
    if part.ends is not None:
        block = jnp.concatenate([part.ends.block, block])
    tiles, q, _ = block.shape
    b = q * pairs.shape[1]
    return jnp.take(pairs, block, axis=0, mode="clip").transpose(0, 1, 3, 2, 4).reshape(tiles, b, b)


def _at(x: Array, i: Array) -> Array:
    return lax.dynamic_index_in_dim(x, i, 0, False)


def _put(x: Array, value: Array, i: Array) -> Array:
    return lax.dynamic_update_index_in_dim(x, value, i, 0)


def _transposed(x: Array) -> Array:
    """Explicit product: XLA has no fast product with a transposed left factor."""
    return lax.optimization_barrier(x.T)


def _factorise(
    tiles: Tiles, empty: Float[Array, "panel b"], columns: PanelColumns, first_tile: int, first_panel: int
) -> Tiles:
    def column(j: Array, tiles: Array) -> Array:
        lower = jnp.tril(_at(tiles, first_tile + j))
        inverse = inverse_factor(lower + jnp.tril(lower, -1).T + jnp.diag(_at(empty, first_panel + j)))
        tiles = _put(tiles, inverse, first_tile + j)

        def below(i: Array, tiles: Array) -> Array:
            a = columns.below[i, 0]
            return _put(tiles, _at(tiles, a) @ inverse.T, a)

        def update(i: Array, tiles: Array) -> Array:
            a, b, target = columns.update[i]
            return _put(tiles, _at(tiles, target) - _at(tiles, a) @ _at(tiles, b).T, target)

        tiles = lax.fori_loop(columns.first_below[j], columns.first_below[j + 1], below, tiles)
        return lax.fori_loop(columns.first_update[j], columns.first_update[j + 1], update, tiles)

    return lax.fori_loop(0, columns.count, column, tiles)


def _forward(tiles: Tiles, y: Sides, columns: PanelColumns, first_tile: int, first_panel: int) -> Sides:
    def column(j: Array, y: Array) -> Array:
        own = _at(tiles, first_tile + j) @ _at(y, first_panel + j)

        def below(i: Array, y: Array) -> Array:
            a, row = columns.below[i]
            return _put(y, _at(y, row) - _at(tiles, a) @ own, row)

        y = _put(y, own, first_panel + j)
        return lax.fori_loop(columns.first_below[j], columns.first_below[j + 1], below, y)

    return lax.fori_loop(0, columns.count, column, y)


def _backward(tiles: Tiles, y: Sides, columns: PanelColumns, first_tile: int, first_panel: int) -> Sides:
    def column(step: Array, y: Array) -> Array:
        j = columns.count - 1 - step

        def below(i: Array, own: Array) -> Array:
            a, row = columns.below[i]
            return own - _at(tiles, a).T @ _at(y, row)

        own = _at(y, first_panel + j)
        own = lax.fori_loop(columns.first_below[j], columns.first_below[j + 1], below, own)
        return _put(y, _at(tiles, first_tile + j).T @ own, first_panel + j)

    return lax.fori_loop(0, columns.count, column, y)


def _unit_factor(tiles: Tiles, columns: PanelColumns, first_tile: int) -> Tiles:
    """Replaces L by K below the diagonal of the given columns."""

    def column(j: Array, k: Array) -> Array:
        inverse = _at(k, first_tile + j)

        def below(i: Array, k: Array) -> Array:
            a = columns.below[i, 0]
            return _put(k, _at(k, a) @ inverse, a)

        return lax.fori_loop(columns.first_below[j], columns.first_below[j + 1], below, k)

    return lax.fori_loop(0, columns.count, column, tiles)


def _selected_inverse(k: Tiles, z: Tiles, columns: PanelColumns, first_tile: int) -> Tiles:
    """Computes Z in the given columns, which are 0 before. `k`: K below the diagonal, C_J on it.

    An iteration of a loop changes one tile of one array; XLA copies whole arrays if it changes more.
    """

    def column(step: Array, z: Array) -> Array:
        j = columns.count - 1 - step
        first, end = columns.first_below[j], columns.first_below[j + 1]
        update, last = columns.first_update[j], columns.first_update[j + 1]

        def left(i: Array, z: Array) -> Array:
            a, b, target = columns.update[i]
            return _put(z, _at(z, a) - _at(z, target) @ _at(k, b), a)

        def right(i: Array, z: Array) -> Array:
            a, b, target = columns.update[i]
            return _put(z, _at(z, b) - _transposed(_at(z, target)) @ _at(k, a), b)

        def own(i: Array, block: Array) -> Array:
            a = columns.below[i, 0]
            return block - _transposed(_at(k, a)) @ _at(z, a)

        z = lax.fori_loop(update, last, left, z)
        z = lax.fori_loop(update + end - first, last, right, z)  # the first ones are diagonal tiles, which are done
        inverse = _at(k, first_tile + j)
        block = lax.fori_loop(first, end, own, _transposed(inverse) @ inverse)
        return _put(z, block, first_tile + j)

    return lax.fori_loop(0, columns.count, column, z)
