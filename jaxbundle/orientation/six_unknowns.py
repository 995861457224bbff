"""Least squares with six unknowns in explicit form, with scalars as input and output.

A scalar may be an array of any shape: thousands of images need the same few operations on long arrays, while
batched calls of a linear algebra library would process each 6 x 6 matrix separately.
Symmetric matrices are lists of their lower rows: (0, 0), (1, 0), (1, 1), (2, 0) ...
"""

import jax.numpy as jnp

from jaxbundle.geometry.rotation import Scalar

UNKNOWNS = 6


def place(row: int, column: int) -> int:
    """Index of an element of the lower triangle."""
    return row * (row + 1) // 2 + column


def cholesky(matrix: list[Scalar]) -> list[Scalar]:
    """The factor L of A = L L^T, with the inverse pivots on its diagonal; not finite if A is not positive definite."""
    factor: list[Scalar] = []
    for i in range(UNKNOWNS):
        for j in range(i + 1):
            rest = matrix[place(i, j)] - sum(factor[place(i, k)] * factor[place(j, k)] for k in range(j))
            factor.append(1 / jnp.sqrt(rest) if i == j else rest * factor[place(j, j)])
    return factor


def forward(factor: list[Scalar], right: list[Scalar]) -> list[Scalar]:
    """Solves L x = b."""
    y: list[Scalar] = []
    for i in range(UNKNOWNS):
        y.append((right[i] - sum(factor[place(i, k)] * y[k] for k in range(i))) * factor[place(i, i)])
    return y


def backward(factor: list[Scalar], right: list[Scalar]) -> list[Scalar]:
    """Solves L^T x = b."""
    x: list[Scalar] = list(right)
    for i in reversed(range(UNKNOWNS)):
        rest = right[i] - sum(factor[place(k, i)] * x[k] for k in range(i + 1, UNKNOWNS))
        x[i] = rest * factor[place(i, i)]
    return x
