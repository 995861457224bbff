"""Compiled programs kept in a folder: who finds his own there needs neither tracing nor compilation.

A program is known by everything it was made of: the function, the static parts of its arguments, shapes, types and
placement of the arrays, the sources of this package, the versions of JAX and its kin, and the machine. A function or a
class from elsewhere (a user's camera model) has sources that are not looked at: a program with such a part is not kept.

A file is a line of JSON, which says what the program is made for, and the program itself. As a program runs, it is read
from a file of the user only that nobody else may write to.
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
LARGEST = 256_000_000  # bytes in memory; the largest program of a block of 1200 images takes a tenth
VERSIONED = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")


class Program(NamedTuple):
    """A compiled program from leaves to leaves, and a tree of numbers that says where the leaves of its value stand."""

    call: Callable[..., list[Array]]
    value: Any

    def __call__(self, leaves: Sequence[Array]) -> Any:
        """The function's value."""
        return jax.tree.unflatten(jax.tree.structure(self.value), self.call(*leaves))


class _Pickler(pickle.Pickler):
    """Writes functions and classes by name, those that belong to a versioned package or to Python only."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, (FunctionType, type)):
            package = obj.__module__.partition(".")[0]
            if package not in (PACKAGE.name, *VERSIONED) and package not in sys.stdlib_module_names:
                raise pickle.PicklingError(f"{obj} has no version")
        return NotImplemented


_kept_in: list[Path] = []  # at most one


def keep_in(path: Path) -> None:
    """Keeps the programs of this process in a folder from now on, if it is the user's alone; else they are not kept."""
    private = private_folder(path)
    _kept_in[:] = [] if private is None else [private]


def chosen_folder() -> Path | None:
    """The folder that `keep_in` was given, None if there is none. Unlike `folder` it does not start JAX."""
    return _kept_in[0] if _kept_in else None


def folder() -> Path | None:
    """Where programs are kept, None where they are not: a program of several processes is made for one of them."""
    return _kept_in[0] if _kept_in and jax.process_count() == 1 else None


def setting(name: str) -> Any:
    """An option of JAX, whose attributes no type checker knows."""
    return getattr(jax.config, name)


@cache
def _origin() -> tuple[Any, ...]:
    """What all programs of this process depend on."""
    sources = sorted((str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in PACKAGE.rglob("*.py"))
    versions = [(name, version(name)) for name in VERSIONED]
    machine = platform.node(), platform.machine(), sys.version, os.environ.get("XLA_FLAGS")
    return sources, versions, machine, [str(device) for device in jax.devices()]


def _placement(array: Array) -> tuple[Any, ...]:
    return array.shape, str(array.dtype), array.weak_type, str(array.sharding) if array.committed else None


def program_name(function: FunctionType, static: Any, arrays: Any, options: Any) -> str | None:
    """The name under which a program is kept; None if it cannot be."""
    settings = [setting(name) for name in ("jax_enable_x64", "jax_debug_nans", "jax_disable_jit")]
    name = function.__module__, function.__qualname__  # not itself: a decorated function is not found by its name
    if name[0].partition(".")[0] != PACKAGE.name or "<" in name[1]:
        return None
    parts = _origin(), settings, name, static, jax.tree.map(_placement, arrays), options
    file = io.BytesIO()
    try:
        _Pickler(file).dump(parts)
    except (pickle.PicklingError, AttributeError, TypeError):  # a local function, or what has no form on disk
        return None
    return hashlib.sha256(file.getvalue()).hexdigest()


def load(file: Path, arrays: Sequence[Array]) -> Program | None:
    """A program that was kept for such arrays; None where there is none, or none that this machine can read."""
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
        os.utime(file)  # used now: the last to be deleted
    except Exception:  # whatever is wrong with the file, the program can be made again
        return None
    return Program(call, value)


def keep(file: Path, compiled: jax.stages.Compiled, arrays: Sequence[Array], value: Any) -> None:
    """Keeps a program for such arrays, if it can be; a reader sees a whole file or none."""
    if "lapack" in (compiled.as_text() or ""):
        return  # JAX prepares LAPACK when it lowers a call: in a process that only loads the program it would crash
    shardings = jax.tree.leaves(compiled.input_shardings)  # None for a leaf that is not used
    devices = max((len(sharding.device_set) for sharding in shardings), default=1)
    try:
        executable, _, _ = serialize_executable.serialize(compiled)
        whole = pickle.dumps((executable, value))
        body, header = zlib.compress(whole, 1), _header(file, arrays, devices, len(whole))
        head = json.dumps({**header, "digest": _digest(header, body)}).encode()
        if len(whole) <= LARGEST and private_folder(file.parent) is not None:
            write_whole(file, lambda stream: stream.write(head + b"\n" + body), mode=0o600)
    except (OSError, ValueError, NotImplementedError, pickle.PicklingError, AttributeError, TypeError):
        return  # a full disk or a program that has no form on disk: the next process compiles again


def _header(file: Path, arrays: Sequence[Array], devices: int, size: int) -> dict[str, Any]:
    """What a program is made for; `size`: its bytes before compression."""
    described = [[list(array.shape), str(array.dtype)] for array in arrays]
    return {"name": file.name, "arrays": described, "devices": devices, "size": size}


def _digest(header: dict[str, Any], body: bytes) -> str:
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode() + body).hexdigest()


def _decompressed(body: bytes, size: int) -> bytes:
    """The program's bytes, of which there must be as many as its header says.

    Raises: ValueError otherwise.
    """
    if not 0 < size <= LARGEST:
        raise ValueError("too large")
    stream = zlib.decompressobj()
    whole = stream.decompress(body, size)
    if len(whole) != size or not stream.eof and stream.decompress(stream.unconsumed_tail, 1):
        raise ValueError("not of its size")
    return whole
