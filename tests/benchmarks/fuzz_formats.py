"""Reads foreign blocks that were made wrong at random: python tests/benchmarks/fuzz_formats.py [--inputs N] [--seed S]

The samples beside the project are copied, one file of each is changed in one or two ways, and the path is read as the
command line reads it. Every input must end in a Block of finite numbers or in a BlockError whose lines can be printed.
"""

import argparse
import shutil
import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np  # noqa: E402
from benchmarks.fuzz_readers import HangError, outcome  # noqa: E402
from cases.mutated_files import bytes_changed  # noqa: E402

from jaxbundle.cli import runtime  # noqa: E402

SAMPLES = (
    "colmap/rig2_synthetic/bin",
    "colmap/rig2_synthetic/txt",
    "opensfm",
    "metashape/sxb",
    "blocksexchange/sxb_blocksexchange.xml",
    "bundler/sxb",
    "opf/sxb",
    "bingo",
    "patb",
    "inpho/sxb.prj",
    "micmac/Ori-Rel",
)
DATA = Path(__file__).parents[3] / "shared" / "data" / "exchange"


def fields_changed(data: bytes, rng: np.random.Generator) -> bytes:
    """A field between blanks replaced by text, or by a number that is too large, negative or infinite."""
    fields = data.split(b" ")
    values = [b"nan", b"-1", b"1e308", b"inf", b"", b"x", b"0", b"99999999999999999999", b"1e-320"]
    fields[int(rng.integers(len(fields)))] = values[int(rng.integers(len(values)))]
    return b" ".join(fields)


def _alarm(*_: object) -> None:
    raise HangError


def main() -> int:
    """Command line; exit code 1 where an input ended as it should not."""
    parser = argparse.ArgumentParser(description="Reads foreign blocks that were made wrong at random.")
    parser.add_argument("--inputs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    runtime.start()
    signal.signal(signal.SIGALRM, _alarm)
    signal.signal(signal.SIGPROF, _alarm)
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        for sample in SAMPLES:
            source, target = DATA / sample, Path(name) / sample.replace("/", "-")
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
            files = [target] if target.is_file() else sorted(x for x in target.iterdir() if x.name != "SOURCE.txt")
            whole = {file: file.read_bytes() for file in files}
            for number in range(options.inputs // len(SAMPLES)):
                rng = np.random.default_rng([options.seed, number, len(sample)])
                file = files[int(rng.integers(len(files)))]
                data = whole[file]
                for _ in range(int(rng.integers(1, 3))):
                    data = (fields_changed if rng.random() < 0.5 else bytes_changed)(data, rng)
                file.write_bytes(data)
                with np.errstate(all="ignore"):
                    found = outcome(target, 60.0)
                count[f"{sample}: {found}"] += 1
                if found not in ("Block", "BlockError"):
                    print(f"{sample}, input {number}, {file.name}: {found}", flush=True)
                file.write_bytes(whole[file])
    for what, times in sorted(count.items()):
        print(f"{times:8d}  {what}")
    return int(any(what.split(": ", 1)[1] not in ("Block", "BlockError") for what in count))


if __name__ == "__main__":
    sys.exit(main())
