"""What the bordered normal equations need of a factorisation A = L L^T of the images' part, whatever its algorithm."""

import abc
from typing import Any, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

F = TypeVar("F")


class AbstractImageFactor(eqx.Module, Generic[F]):
    """One algorithm. Blocks are d x d, of the pairs i >= j of images in the order of elimination."""

    @abc.abstractmethod
    def factorise(self, pairs: Float[Array, "pair d d"]) -> F:
        """L; images that no block mentions get a unit row. NaN from the first pivot on that is not positive."""

    @abc.abstractmethod
    def pivots(self, factor: F, images: int, d: int) -> Float[Array, "image d"]:
        """Squares of the diagonal of L; any number for an image that no block mentions."""

    @abc.abstractmethod
    def forward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """L^-1 r."""

    @abc.abstractmethod
    def backward(self, factor: F, right: Float[Array, "image d k"]) -> Float[Array, "image d k"]:
        """L^-T y."""

    @abc.abstractmethod
    def selected_inverse(self, factor: F, d: int) -> Float[Array, "pair d d"]:
        """Blocks of A^-1 of the pairs; 0 where a block is not in use."""


ImageFactor = AbstractImageFactor[Any]
