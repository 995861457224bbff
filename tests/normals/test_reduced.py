"""The reduced normal equations against dense linear algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbundle.normals import reduced_system as reduced
from jaxbundle.normals.from_block import reduced_solver
from jaxbundle.normals.plan.elimination_order import elimination_order, image_graph, ranked_pairs
from jaxbundle.normals.plan.reduced_plan import ReducedPlan, reduced_plan

IMAGES = 45
GRAPHS = ("strip", "ring", "star", "islands", "random")
CASES = [(graph, 6, 5, "panels") for graph in GRAPHS] + [
    ("strip", 9, 0, "panels"),
    ("islands", 9, 5, "panels"),
    ("random", 9, 0, "dense"),
    ("strip", 6, 5, "dense"),
]


def graph_of(kind: str, rng: np.random.Generator) -> np.ndarray:
    i, j = (x.ravel() for x in np.mgrid[:IMAGES, :IMAGES])
    near = {
        "strip": i - j < 6,
        "ring": ((i - j) % IMAGES < 3) | ((j - i) % IMAGES < 3),
        "star": j == 0,
        "islands": (i - j < 4) & (i // 15 == j // 15),
        "random": rng.random(i.shape) < 0.08,
    }[kind]
    pairs = np.stack([i, j], 1)[(near & (i > j)) | (i == j)]
    return rng.permutation(IMAGES)[pairs]


def problem(plan: ReducedPlan, d: int, border: int, rng: np.random.Generator):
    """A random system that is positive on its free unknowns, and its dense matrix, diagonal, right side and free."""
    size = plan.images * d
    pool = rng.normal(size=(plan.blocks, d, d))
    dense = np.zeros((size + border, size + border))
    for k, (i, j) in enumerate(plan.pairs):
        rows, columns = slice(i * d, i * d + d), slice(j * d, j * d + d)
        if i == j:
            pool[k] += pool[k].T + 40 * np.eye(d)
        dense[rows, columns] = pool[k]
        dense[columns, rows] = pool[k].T
    coupling = rng.normal(size=(plan.images, d, border))
    corner = rng.normal(size=(border, border))
    corner = corner + corner.T + 500 * np.eye(border)
    dense[:size, size:] = coupling.reshape(size, border)
    dense[size:, :size] = coupling.reshape(size, border).T
    dense[size:, size:] = corner
    diagonal = np.concatenate([rng.uniform(40, 90, size), rng.uniform(300, 900, border)])
    right = rng.normal(size=size + border)
    free = rng.random(size + border) < 0.9
    free[IMAGES * d : size] = False
    by_image = lambda x: jnp.asarray(x[:size].reshape(plan.images, d))  # noqa: E731
    system = reduced.ReducedSystem(
        jnp.asarray(pool),
        by_image(diagonal),
        by_image(right),
        by_image(free),
        jnp.asarray(coupling),
        jnp.asarray(corner),
        *(jnp.asarray(x[size:]) for x in (diagonal, right, free)),
    )
    return system, dense, diagonal, right, free


def check(graph: str, d: int, border: int, method, devices: int, q: int = 4) -> None:
    """Step, cofactors and pivots against dense algebra."""
    rng = np.random.default_rng(3)
    plan = reduced_plan(graph_of(graph, rng), IMAGES, d, devices, method, q=q)
    system, dense, diagonal, right, free = problem(plan, d, border, rng)
    damping, size = 0.03, plan.images * d
    damped = (dense + damping * np.diag(diagonal))[np.ix_(free, free)]
    x, inverse = np.zeros(len(dense)), np.zeros_like(dense)
    x[free] = np.linalg.solve(damped, right[free])
    inverse[np.ix_(free, free)] = np.linalg.inv(damped)

    def run(solver, system):
        factor = reduced.factorise(solver, system, jnp.asarray(damping))
        step = reduced.step(solver, factor)
        return step, reduced.cofactors(solver, factor), (factor.pivots, factor.border_pivots)

    if devices > 1:
        mesh = jax.make_mesh((devices,), ("device",), axis_types=(jax.sharding.AxisType.Auto,))
        everywhere = jax.sharding.PartitionSpec()
        run = jax.shard_map(run, mesh=mesh, in_specs=everywhere, out_specs=everywhere, check_vma=False)
    step, cofactors, pivots = jax.jit(run)(reduced_solver(plan), system)

    step = np.concatenate([np.ravel(part) for part in step])
    np.testing.assert_allclose(step, x, rtol=0, atol=1e-11 * abs(x).max())
    allowed = 1e-10 * abs(inverse).max()
    images = inverse[:size, :size].reshape(plan.images, d, plan.images, d)
    expected = np.zeros((plan.blocks, d, d))
    expected[: len(plan.pairs)] = images[plan.pairs[:, 0], :, plan.pairs[:, 1]]
    np.testing.assert_allclose(cofactors.pairs, expected, rtol=0, atol=allowed)
    np.testing.assert_allclose(
        np.reshape(cofactors.coupling, (size, border)), inverse[:size, size:], rtol=0, atol=allowed
    )
    np.testing.assert_allclose(cofactors.border, inverse[size:, size:], rtol=0, atol=allowed)
    share = np.concatenate([pivots[0].ravel(), pivots[1]])
    assert np.all(share[~free] == 1)
    scaled = damped / np.sqrt(np.outer(diagonal[free], diagonal[free]))
    assert np.log(share[free]).sum() == pytest.approx(np.linalg.slogdet(scaled)[1], rel=1e-10)


@pytest.mark.parametrize(("graph", "d", "border", "method"), CASES)
def test_step_and_cofactors_are_those_of_the_dense_matrix(graph, d, border, method):
    check(graph, d, border, method, devices=1)


@pytest.mark.parametrize(("graph", "d", "border", "method"), (CASES[0], CASES[3], CASES[-1]))
def test_two_devices_agree_with_the_dense_matrix(graph, d, border, method):
    check(graph, d, border, method, devices=2)


def test_a_factor_serves_several_right_hand_sides():
    rng = np.random.default_rng(4)
    plan = reduced_plan(graph_of("strip", rng), IMAGES, 6, 1, "panels", q=4)
    system, *_ = problem(plan, 6, 5, rng)
    images = jnp.stack([system.right, 2 * system.right], 2)
    border = jnp.stack([system.border_right, 2 * system.border_right], 1)

    def run(solver, system):
        factor = reduced.factorise(solver, system, jnp.asarray(0.1))
        return reduced.step(solver, factor), reduced.solve(solver, factor, images, border)

    step, several = jax.jit(run)(reduced_solver(plan), system)
    for one, two in zip(step, several, strict=True):
        np.testing.assert_allclose(two, np.stack([one, 2 * one], -1), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("method", ["dense", "panels"])
def test_an_undetermined_unknown_has_no_pivot(method):
    rng = np.random.default_rng(5)
    plan = reduced_plan(graph_of("strip", rng), IMAGES, 6, 1, method, q=4)
    system, *_ = problem(plan, 6, 0, rng)
    system = reduced.ReducedSystem(
        **{**vars(system), "free": jnp.arange(plan.images)[:, None] < jnp.full((1, 6), IMAGES)}
    )
    block = int(np.nonzero((plan.pairs[:, 0] == 20) & (plan.pairs[:, 1] == 20))[0][0])
    touches = jnp.asarray(np.nonzero((plan.pairs[:, 0] == 20) ^ (plan.pairs[:, 1] == 20))[0])
    imitated = system.pairs[block].at[3].set(system.pairs[block, 2]).at[:, 3].set(system.pairs[block, :, 2])
    imitated = imitated.at[3, 3].set(imitated[2, 2])
    pool = system.pairs.at[block].set(imitated).at[touches].set(0.0)
    system = reduced.ReducedSystem(**{**vars(system), "pairs": pool})
    factorise = jax.jit(reduced.factorise)
    pivots = np.asarray(factorise(reduced_solver(plan), system, jnp.asarray(0.0)).pivots)
    assert not pivots[20, 3] > 1e-12
    assert np.all(pivots[:20] > 0.01)
    assert np.nanmin(np.asarray(factorise(reduced_solver(plan), system, jnp.asarray(1e-3)).pivots)) > 1e-4


@pytest.mark.parametrize("method", ["dense", "panels"])
def test_blocks_of_similar_size_share_a_program(method):
    traced = []

    @jax.jit
    def factorise(*arguments):
        traced.append(True)
        return reduced.factorise(*arguments)

    rng = np.random.default_rng(7)
    i, j = np.mgrid[:IMAGES, :IMAGES]
    pairs = np.argwhere((i >= j) & (i - j < 6))
    for images in (IMAGES, IMAGES - 1):
        plan = reduced_plan(pairs[(pairs < images).all(1)], images, 6, 1, method, q=4)
        factorise(reduced_solver(plan), problem(plan, 6, 5, rng)[0], jnp.asarray(0.1))
    assert len(traced) == 1


def test_what_lies_in_the_waste_bin_does_not_matter():
    rng = np.random.default_rng(9)
    plan = reduced_plan(graph_of("ring", rng), IMAGES, 6, 1, "panels", q=4)
    system, *_ = problem(plan, 6, 0, rng)
    spoilt = reduced.ReducedSystem(**{**vars(system), "pairs": system.pairs.at[-1].set(jnp.nan)})
    run = jax.jit(
        lambda s: reduced.step(reduced_solver(plan), reduced.factorise(reduced_solver(plan), s, jnp.asarray(0.1)))[0]
    )
    np.testing.assert_array_equal(run(system), run(spoilt))


def test_the_image_graph_is_exactly_the_pairs_that_share_a_point():
    rng = np.random.default_rng(11)
    seen = rng.random((200, 30)) < 0.07
    point, image = np.nonzero(np.repeat(seen, 3, axis=0))
    mixed = rng.permutation(len(point))
    pairs = image_graph(image[mixed], point[mixed], 30, 600, extra=np.array([[2, 29]]))
    shared = (seen.T.astype(int) @ seen > 0) | np.eye(30, dtype=bool)
    shared[29, 2] = True
    np.testing.assert_array_equal(pairs, np.argwhere(np.tril(shared)))


def test_no_image_of_one_end_shares_a_point_with_the_other():
    pairs = graph_of("strip", np.random.default_rng(13))
    order = elimination_order(pairs, IMAGES, 4, 2)
    left, right, separator = order.sizes
    assert min(left, right, separator) > 0
    i, j = ranked_pairs(pairs, order.rank).T
    assert not np.any((j < left) & (i >= left) & (i < left + right))
