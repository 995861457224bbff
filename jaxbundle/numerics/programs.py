"""Cache of compiled programs in a folder: a cached program needs neither tracing nor compilation.

The key of a program includes all its inputs: the function, the static parts of its arguments, shapes, types and
placement of the arrays, the sources of this package, the versions of JAX and related packages, and the machine. The
sources of other functions or classes (a user's camera model) are not checked: a program with such a part is not cached.

A file consists of a line of JSON, which describes the program, and the program. As a program is executed, it is only
read from a file of the user that nobody else may write to.
"""

import hashlib
import io
import json
import os
import pickle
import platform
import sys
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import jax
from jax import Array
from jax.experimental import serialize_executable

from jaxbundle.numerics.private_folder import private_folder, read_private
from jaxbundle.numerics.whole_files import write_whole

PACKAGE = Path(__file__).parent.parent
LARGEST = 256_000_000  # bytes in memory; the largest program of a block of 1200 images needs a tenth
VERSIONED = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")


class Program(NamedTuple):
    """A compiled program from leaves to leaves, and a tree of indices for the leaves of its value."""

    call: Callable[..., list[Array]]
    value: Any

    def __call__(self, leaves: Sequence[Array]) -> Any:
        """Runs the program and returns the value."""
        return jax.tree.unflatten(jax.tree.structure(self.value), self.call(*leaves))


class _Pickler(pickle.Pickler):
    """Pickles functions and classes by name, only those of a versioned package or of Python."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, (FunctionType, type)):
            package = obj.__module__.partition(".")[0]
            if package not in (PACKAGE.name, *VERSIONED) and package not in sys.stdlib_module_names:
                raise pickle.PicklingError(f"{obj} has no version")
        return NotImplemented


_kept_in: list[Path] = []  # at most one entry


def keep_in(path: Path) -> None:
    """Sets the cache folder for the programs of this process; without effect if the folder is not private."""
    private = private_folder(path)
    _kept_in[:] = [] if private is None else [private]


def chosen_folder() -> Path | None:
    """The folder that `keep_in` was given, None if there is none. Unlike `folder` it does not start JAX."""
    return _kept_in[0] if _kept_in else None


def folder() -> Path | None:
    """The cache folder, None without cache: a program of several processes is valid for only one of them."""
    return _kept_in[0] if _kept_in and jax.process_count() == 1 else None


def setting(name: str) -> Any:
    """An option of JAX; type checkers do not know its attributes."""
    return getattr(jax.config, name)


@cache
def _origin() -> tuple[Any, ...]:
    """Common inputs of all programs of this process."""
    sources = sorted((str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in PACKAGE.rglob("*.py"))
    versions = [(name, version(name)) for name in VERSIONED]
    machine = platform.node(), platform.machine(), sys.version, os.environ.get("XLA_FLAGS")
    return sources, versions, machine, [str(device) for device in jax.devices()]


def _placement(array: Array) -> tuple[Any, ...]:
    return array.shape, str(array.dtype), array.weak_type, str(array.sharding) if array.committed else None


def program_name(function: FunctionType, static: Any, arrays: Any, options: Any) -> str | None:
    """The file name of a program; None if it cannot be cached."""
    settings = [setting(name) for name in ("jax_enable_x64", "jax_debug_nans", "jax_disable_jit")]
    name = (
        function.__module__,
        function.__qualname__,
    )  # not the object itself: a decorated function cannot be imported by its name
    if name[0].partition(".")[0] != PACKAGE.name or "<" in name[1]:
        return None
    parts = _origin(), settings, name, static, jax.tree.map(_placement, arrays), options
    file = io.BytesIO()
    try:
        _Pickler(file).dump(parts)
    except (pickle.PicklingError, AttributeError, TypeError):  # a local function, or an object that cannot be pickled
        return None
    return hashlib.sha256(file.getvalue()).hexdigest()


def load(file: Path, arrays: Sequence[Array]) -> Program | None:
    """Reads a cached program for such arrays; None if there is none that this machine can read."""
    data = read_private(file)
    if data is None:
        return None
    try:
        head, _, body = data.partition(b"\n")
        header = json.loads(head)
        digest = header.pop("digest")
        if header != _header(file, arrays, header["devices"], header["size"]) or digest != _digest(header, body):
            return None
        executable, value = pickle.loads(_decompressed(body, header["size"]))
        in_tree = jax.tree.structure((tuple(range(len(arrays))), {}))
        out_tree = jax.tree.structure(list(range(len(jax.tree.leaves(value)))))
        call = serialize_executable.deserialize_and_load(
            executable, in_tree, out_tree, execution_devices=jax.devices()[: header["devices"]]
        )
        os.utime(file)  # mark it as used, so that it is deleted last
    except Exception:  # for any error of the file, the program is compiled again
        return None
    return Program(call, value)


def keep(file: Path, compiled: jax.stages.Compiled, arrays: Sequence[Array], value: Any) -> None:
    """Writes a program for such arrays to the cache, if possible; a reader sees a whole file or none."""
    if "lapack" in (compiled.as_text() or ""):
        return  # JAX initialises LAPACK when it lowers a call: a process that only loads the program would crash
    shardings = jax.tree.leaves(compiled.input_shardings)  # None for an unused leaf
    devices = max((len(sharding.device_set) for sharding in shardings), default=1)
    try:
        executable, _, _ = serialize_executable.serialize(compiled)
        whole = pickle.dumps((executable, value))
        body, header = zlib.compress(whole, 1), _header(file, arrays, devices, len(whole))
        head = json.dumps({**header, "digest": _digest(header, body)}).encode()
        if len(whole) <= LARGEST and private_folder(file.parent) is not None:
            write_whole(file, lambda stream: stream.write(head + b"\n" + body), mode=0o600)
    except (OSError, ValueError, NotImplementedError, pickle.PicklingError, AttributeError, TypeError):
        return  # a full disk, or a program that cannot be serialised: the next process compiles again


def _header(file: Path, arrays: Sequence[Array], devices: int, size: int) -> dict[str, Any]:
    """Description of a program; `size`: its bytes before compression."""
    described = [[list(array.shape), str(array.dtype)] for array in arrays]
    return {"name": file.name, "arrays": described, "devices": devices, "size": size}


def _digest(header: dict[str, Any], body: bytes) -> str:
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode() + body).hexdigest()


def _decompressed(body: bytes, size: int) -> bytes:
    """The bytes of the program, whose number must agree with its header.

    Raises: ValueError otherwise.
    """
    if not 0 < size <= LARGEST:
        raise ValueError("too large")
    stream = zlib.decompressobj()
    whole = stream.decompress(body, size)
    if len(whole) != size or not stream.eof and stream.decompress(stream.unconsumed_tail, 1):
        raise ValueError("size differs from header")
    return whole
