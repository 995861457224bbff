"""Checkpoints: the state of a solve in a file, so that an interrupted one can go on.

The file holds the unknowns in the order of the block and the state of the search, and a fingerprint of everything the
solve depends on. It is written beside its place and moved there: it is never half written. What it holds is looked at
before it is used: shapes, types, and whether numbers are finite.
"""

import hashlib
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.numerics.devices import equal_in_all_processes, from_first_process, is_first_process
from jaxbundle.numerics.host import on_device, on_host
from jaxbundle.numerics.whole_files import write_whole

_HEADERS = 4096  # bytes of a file beside one array: its header of numpy and its entries in the archive
_CURE = "delete it or name another file"


class CheckpointError(ValueError):
    """A file that is no checkpoint of this solve."""


class ClusterError(ValueError):
    """Processes of a cluster that do not do the same."""


def fingerprint(block: Block, method: str) -> str:
    """Mark of a block's structure and values, and of the method."""
    mark = hashlib.sha256(method.encode())
    structure = block.structure
    names = structure.image_names, structure.point_names, tuple(c.name for c in structure.cameras), structure.model.name
    mark.update(repr(names).encode())
    arrays = [
        structure.image_camera,
        structure.ray_image,
        structure.ray_point,
        structure.exterior_free,
        structure.interior_free,
        structure.parameter_free,
        structure.point_free,
        *jax.tree.leaves(block),
        *(x for group in block.groups for x in (group.structure.indices, group.structure.observed)),
    ]
    for array in arrays:
        mark.update(np.ascontiguousarray(array).tobytes())
    return mark.hexdigest()


def require_same_block(block: Block, method: str) -> None:
    """Raises a ClusterError where the processes of a cluster do not adjust the same block by the same method."""
    if jax.process_count() > 1 and not equal_in_all_processes(bytes.fromhex(fingerprint(block, method))):
        raise ClusterError(
            f"the {jax.process_count()} processes adjust different blocks; give all of them the same files, read by the"
            " same version of the program with the same options"
        )


def save(path: Path, mark: str, unknowns: Unknowns, state: Any) -> None:
    """Writes a checkpoint.

    Raises: OSError where the place cannot be written.
    """
    arrays: dict[str, Any] = {
        f"leaf {k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves((unknowns, state)))
    }
    try:
        write_whole(path, lambda file: np.savez(file, fingerprint=np.array(mark), **arrays))
    except OSError as error:
        reason = error.strerror or str(error)
        raise type(error)(f"the checkpoint {path} cannot be written: {reason}; name another file") from error


def load(path: Path, mark: str, unknowns: Unknowns, state: Any) -> tuple[Unknowns, Any]:
    """The checkpoint's unknowns and state; `unknowns` and `state` give their form.

    Raises: CheckpointError for a file that is none, one of another block or method, or one of impossible content.
    """
    form = [on_host(leaf) for leaf in jax.tree.leaves((unknowns, state))]
    try:
        with zipfile.ZipFile(path) as archive:  # what it takes in memory is known before it is read
            size = sum(entry.file_size for entry in archive.infolist())
        if size > sum(leaf.nbytes for leaf in form) + _HEADERS * (len(form) + 1):
            raise CheckpointError(f"{path} is the checkpoint of another block, or damaged; {_CURE}")
        with np.load(path, allow_pickle=False) as stored:
            found = str(stored["fingerprint"])
            leaves = [stored[f"leaf {k}"] for k in range(len(stored.files) - 1)]
    except CheckpointError:
        raise
    except (ValueError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise CheckpointError(f"{path} is no checkpoint; {_CURE}") from error
    if found != mark:
        raise CheckpointError(f"{path} is the checkpoint of another block or method; {_CURE}")
    _require_form(path, leaves, form)
    return jax.tree.unflatten(jax.tree.structure((unknowns, state)), [on_device(leaf) for leaf in leaves])


def _require_form(path: Path, leaves: list[np.ndarray], form: list[np.ndarray]) -> None:
    """Raises CheckpointError where an array has another shape or type than the form, or is not finite as that is."""
    if len(leaves) != len(form):
        raise CheckpointError(f"{path} holds {len(leaves)} arrays in place of {len(form)}; {_CURE}")
    for k, (leaf, wanted) in enumerate(zip(leaves, form, strict=True)):
        if (leaf.shape, leaf.dtype) != (wanted.shape, wanted.dtype):
            what = f"{leaf.dtype} of shape {leaf.shape} in place of {wanted.dtype} of shape {wanted.shape}"
            raise CheckpointError(f"{path} is damaged: its array {k} is {what}; {_CURE}")
        if not (np.isfinite(leaf) | ~np.isfinite(wanted)).all():
            raise CheckpointError(f"{path} is damaged: its array {k} holds what is not a finite number; {_CURE}")


class Keeper(NamedTuple):
    """Keeps the state of one solve in one file."""

    path: Path
    mark: str

    def resumed(self, unknowns: Unknowns, state: Any) -> tuple[Unknowns, Any]:
        """The state to go on from; the one given, and kept from now on, where there is no file yet.

        Of several processes the first one reads and writes the file.
        """
        if self.path.exists() and is_first_process():
            unknowns, state = load(self.path, self.mark, unknowns, state)
        else:
            self.keep(unknowns, state)  # a place that cannot be written is told before the work
        return from_first_process((unknowns, state))

    def keep(self, unknowns: Unknowns, state: Any) -> None:
        """Keeps the state."""
        if is_first_process():
            save(self.path, self.mark, unknowns, state)
