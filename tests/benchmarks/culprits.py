"""Who is named: python tests/benchmarks/culprits.py [--draws 8] [--clean 40] [--seed 1] [--blocks strip weighted ...]

Simulated blocks get one mistake each, of a size in multiples of the smallest error that the test at its level (5 % of
all tests together) finds with its power (80 %). A line for each kind and size: draws, those that did not converge, the
culprit named first, named at all, draws in which others are named too. What cannot be told apart counts as named.
"""

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np  # noqa: E402

from jaxbundle.cli import runtime  # noqa: E402

runtime.start()

from cases.gross_errors import BLOCKS, KINDS, Simulated, drawn_outcome  # noqa: E402

from jaxbundle.statistics.suspects import find_suspects  # noqa: E402

MULTIPLES = (1.0, 2.0, 4.0, 30.0, 1000.0)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Simulates mistakes and counts who is named.")
    parser.add_argument("--draws", type=int, default=8, help="for each block, kind and size")
    parser.add_argument("--clean", type=int, default=40, help="blocks without a mistake, for each kind of block")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--blocks", nargs="+", choices=list(BLOCKS), default=list(BLOCKS))
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--multiples", nargs="+", type=float, default=list(MULTIPLES))
    given = parser.parse_args()
    cells: dict[tuple[str, str], Counter] = {}
    for name in given.blocks:
        simulated, rng = Simulated(name), np.random.default_rng(given.seed)
        clean = Counter()
        for _ in range(given.clean):
            clean["draws"] += 1
            clean["blamed"] += bool(find_suspects(simulated.adjusted(rng, None, 0.0)).suspicions)
        print(f"{name}: {clean['draws']} clean blocks, {clean['blamed']} blamed", flush=True)
        for kind in given.kinds:
            for multiple in given.multiples:
                _cell(simulated, kind, multiple, given.draws, rng, cells)
    print(f"{'kind':20} {'x MDE':>12} draws no-result first found blamed")
    for (kind, multiple), n in cells.items():
        print(f"{kind:20} {multiple:>12} {_counts(n)}")
    return 0


def _cell(simulated: Simulated, kind: str, multiple: float, draws: int, rng: np.random.Generator, cells: dict) -> None:
    """Draws of one block, kind and size."""
    own, sizes, fixed = Counter(), [], False
    for _ in range(draws):
        found = drawn_outcome(simulated, kind, multiple, rng)
        if found is None:
            return
        outcome, mistake = found
        fixed = mistake.fixed
        sizes.append((1.0 if fixed else multiple) * mistake.detectable)
        own["draws"] += 1
        own["none"] += outcome is None
        if outcome is not None:
            own["first"] += outcome.first
            own["found"] += outcome.found
            own["blamed"] += outcome.wrongly > 0
    if fixed and multiple != MULTIPLES[0]:
        return
    label = "as it is" if fixed else f"{multiple:g}"
    cells.setdefault((kind, label), Counter()).update(own)
    size = f"1/{np.median(sizes):.2g} MDE" if fixed else f"median size {np.median(sizes):.3g}"
    print(f"{simulated.name:18} {kind:20} {label:>8} {size:24} {_counts(own)}", flush=True)


def _counts(n: Counter) -> str:
    return f"{n['draws']:5} {n['none']:9} {n['first']:5} {n['found']:5} {n['blamed']:6}"


if __name__ == "__main__":
    sys.exit(main())
