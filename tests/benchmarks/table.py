"""What the benchmark prints: the machine, one table a block, and the growth with the rays."""

import os
import platform
import time
from pathlib import Path

import numpy as np
from programs import CORES, Timing, versions

HEADER = f"{'iteration ms':>12} {'ratio':>6} {'command s':>10} {'ratio':>6} {'peak MB':>8} {'ratio':>6}"
PARTS = ("linearise, eliminate", "reduced solve", "substitute")


def print_machine(ceres: Path | None) -> None:
    """Cores, processor, load and versions."""
    load = " ".join(f"{x:.2f}" for x in os.getloadavg())
    print(f"{time.strftime('%Y-%m-%d %H:%M')}, {CORES} cores, {_processor()}, load average {load}")
    print(", ".join(f"{name} {version}" for name, version in versions(ceres).items()), flush=True)


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def best_of_ceres(results: dict[str, Timing]) -> Timing | None:
    """The best of its solvers in each column by itself: the harder comparison. None where it took no part."""
    timings = [t for name, t in results.items() if name.startswith("Ceres")]
    return Timing(*(min(column) for column in zip(*timings, strict=True))) if timings else None


def print_block(
    file: Path, size: tuple[int, int, int], results: dict[str, Timing], parts: dict[str, float], failed: dict[str, str]
) -> None:
    """One block's table; ratios are to the best of Ceres in the same column."""
    images, points, rays = size
    print(f"\n{file.name}: {images} images, {points} points, {rays} rays")
    print(f"  {'':22} {HEADER}  {'cost':<17} {'- Ceres':>8}")
    best = best_of_ceres(results)
    for name, t in results.items():
        iteration, command, memory, cost = ("-",) * 4
        if best:
            iteration, command, memory = (f"{x / y:.2f}" for x, y in zip(t[:3], best[:3], strict=True))
            cost = f"{t.cost / best.cost - 1:+.0e}"
        print(
            f"  {name:22} {1e3 * t.iteration:12.1f} {iteration:>6} {t.command:10.2f} {command:>6}"
            f" {t.memory:8.0f} {memory:>6}  {t.cost:<17.11e} {cost:>8}"
        )
        if name == "jaxbundle":
            _print_parts(parts)
    for name, why in failed.items():
        print(f"  {name}: {why}")
    print(end="", flush=True)


def _print_parts(parts: dict[str, float]) -> None:
    """Each part by itself, as a share of the step that was timed in the same process."""
    step = parts.get("step", float("nan"))
    for name in PARTS:
        if name in parts:
            print(f"    {name:20} {1e3 * parts[name]:12.1f}   {parts[name] / step:.2f} of a step")
    if "cofactors" in parts:
        seconds = parts["cofactors"]
        print(
            f"    {'standard deviations':20} {1e3 * seconds:12.1f}   {seconds / step:.2f} steps: all images, all points"
        )


def print_growth(blocks: list[tuple[int, dict[str, Timing]]]) -> None:
    """Exponents of times and memory in the rays, by a straight line through the logarithms."""
    ours = [(rays, results["jaxbundle"]) for rays, results in blocks if "jaxbundle" in results]
    theirs = [(rays, best) for rays, results in blocks if (best := best_of_ceres(results))]
    for name, timings in (("jaxbundle", ours), ("Ceres", theirs)):
        if len(timings) >= 3:
            logarithms = np.log([rays for rays, _ in timings])
            columns = {"iteration": 0, "command": 1, "peak memory": 2}
            powers = {
                what: np.polyfit(logarithms, np.log([t[k] for _, t in timings]), 1)[0] for what, k in columns.items()
            }
            words = ", ".join(f"{what} {power:.2f}" for what, power in powers.items())
            print(f"\n{name} grows with the rays to the power: {words}")
