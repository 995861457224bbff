"""Which hypotheses explain the residuals: of a small linear model, whose cofactors are formed here."""

import numpy as np

from jaxbundle.block.findings import Subject
from jaxbundle.statistics.error_columns import ErrorTests
from jaxbundle.statistics.hypotheses import Cause, Hypothesis
from jaxbundle.statistics.selection import Selection

MEASUREMENTS, STATIONS = 40, 8


def selection(errors: np.ndarray, seed: int = 0) -> Selection:
    """Tests of each of the first observations of a linear model, and of a common shift of all of these."""
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((MEASUREMENTS + STATIONS, 4))
    orthogonal, _ = np.linalg.qr(design)
    observed = rng.standard_normal(len(design))
    observed[:STATIONS] += errors
    residuals = orthogonal @ (orthogonal.T @ observed) - observed
    columns = np.concatenate([np.eye(len(design), STATIONS), np.eye(len(design), STATIONS).sum(1, keepdims=True)], 1)
    tests = ErrorTests(
        columns.T @ residuals,
        columns.T @ (columns - orthogonal @ (orthogonal.T @ columns)),
        (columns**2).sum(0),
        float(residuals @ residuals),
        len(design) - design.shape[1],
    )
    single = [
        Hypothesis((Subject("stations", (str(k),)),), Cause.VALUE, (k,), ("X0",), ("m",), frozenset({(1, k)}))
        for k in range(STATIONS)
    ]
    all_of_them = frozenset((1, k) for k in range(STATIONS))
    group = Hypothesis((Subject("stations"),), Cause.SHIFT, (STATIONS,), ("X0",), ("m",), all_of_them)
    return Selection(tests, [*single, group], float(np.log(1e-3)))


def test_rows_that_are_wrong_alike_are_one_error_of_their_group():
    """However they were found: eight sizes explain no more than the common one."""
    tested = selection(np.full(STATIONS, 500.0))
    assert tested.select(25, start=list(range(STATIONS))) == [STATIONS]
    assert tested.select(25) == [STATIONS]


def test_rows_that_are_wrong_by_different_errors_are_named_one_by_one():
    """A group without a common error is not named for its members."""
    errors = np.zeros(STATIONS)
    errors[[1, 4, 6]] = 500.0, -300.0, 200.0
    assert selection(errors).select(25) == [1, 4, 6]


def test_a_row_that_is_wrong_beside_the_common_error_is_named_too():
    errors = np.full(STATIONS, 500.0)
    errors[3] += 80.0
    tested = selection(errors)
    assert sorted(tested.select(25, start=list(range(STATIONS)))) == sorted(tested.select(25)) == [3, STATIONS]
