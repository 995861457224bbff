"""Who is named: python tests/benchmarks/culprits.py [--draws 8] [--clean 40] [--seed 1] [--blocks strip weighted ...]

Simulated blocks get one mistake each, of a size in multiples of the smallest error that the test at its level (5 % of
all tests together) finds with its power (80 %). A line for each block, kind and size: the power of the test, which is
what theory allows; draws, those whose adjustment gave no result, the culprit named first, named at all, draws in which
others are named too. What cannot be told apart counts as named. Where there is no result, what `findings` names as
having kept the block from one is counted.
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
from scipy.special import ndtr, ndtri  # noqa: E402

from jaxbundle.statistics.reliability_tables import POWER  # noqa: E402
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
    all_clean = Counter()
    for name in given.blocks:
        simulated, rng = Simulated(name), np.random.default_rng(given.seed)
        clean = Counter()
        for _ in range(given.clean):
            clean["draws"] += 1
            clean["blamed"] += bool(find_suspects(simulated.adjusted(rng, None, 0.0)).suspicions)
        all_clean.update(clean)
        print(f"{name}: {clean['draws']} clean blocks, {clean['blamed']} blamed", flush=True)
        for kind in given.kinds:
            for multiple in given.multiples:
                if _cell(simulated, kind, multiple, given.draws, rng, cells):
                    break
    print(f"all: {all_clean['draws']} clean blocks, {all_clean['blamed']} blamed")
    print(f"{'kind':20} {'x MDE':>12} draws no-result first found blamed")
    for (kind, multiple), n in cells.items():
        print(f"{kind:20} {multiple:>12} {_counts(n)}")
    return 0


def _cell(simulated: Simulated, kind: str, multiple: float, draws: int, rng: np.random.Generator, cells: dict) -> bool:
    """Draws of one block, kind and size; whether that size is no matter of choice, or the block has no such rows."""
    own, sizes, label = Counter(), [], f"{multiple:g}"
    for _ in range(draws):
        found = drawn_outcome(simulated, kind, multiple, rng)
        if found is None:
            return True
        outcome, result, mistake = found
        label = "as it is" if mistake.fixed else label
        sizes.append((1.0 if mistake.fixed else multiple) * mistake.detectable)
        own["draws"] += 1
        own["none"] += not result
        own["first"] += outcome.first
        own["found"] += outcome.found
        own["blamed"] += outcome.wrongly > 0
    cells.setdefault((kind, label), Counter()).update(own)
    fixed = label == "as it is"
    size = f"{1 / np.median(sizes):.2g} MDE" if fixed else f"median size {np.median(sizes):.3g}"
    print(f"{simulated.name:18} {kind:20} {label:>8} {size:24} {_theory(simulated, label)} {_counts(own)}", flush=True)
    return fixed


def _theory(simulated: Simulated, label: str) -> str:
    """Power of the test of a single error of this size: what can be found at all."""
    if label == "as it is":
        return "   -"
    limit = simulated.root - ndtri(POWER)
    return f"{ndtr(float(label) * simulated.root - limit):4.2f}"


def _counts(n: Counter) -> str:
    return f"{n['draws']:5} {n['none']:9} {n['first']:5} {n['found']:5} {n['blamed']:6}"


if __name__ == "__main__":
    sys.exit(main())
