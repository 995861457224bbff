"""Checkpoints: the state of a solve in a file, to resume an interrupted one.

The file contains the unknowns in the order of the block, the state of the search, and a fingerprint of all inputs of
the solve. It is written under another name and then renamed, so it is never half-written. Shapes, types and finiteness
of its content are checked before use.
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

_HEADERS = 4096  # bytes per array in addition to its data: the header of numpy and the entries of the archive
_CURE = "delete it or name another file"


class CheckpointError(ValueError):
    """The error for a file that is not a checkpoint of this solve."""


class ClusterError(ValueError):
    """The error for processes of a cluster with different inputs."""


def fingerprint(block: Block, method: str) -> str:
    """Fingerprint of a block's structure and values, and of the method."""
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
    """Raises a ClusterError if the processes of a cluster do not adjust the same block by the same method."""
    if jax.process_count() > 1 and not equal_in_all_processes(bytes.fromhex(fingerprint(block, method))):
        raise ClusterError(
            f"the {jax.process_count()} processes adjust different blocks; give all of them the same files, read by the"
            " same version of the program with the same options"
        )


def save(path: Path, mark: str, unknowns: Unknowns, state: Any) -> None:
    """Writes a checkpoint to a file.

    Raises: OSError where the file cannot be written.
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
    """Reads unknowns and state of a checkpoint; `unknowns` and `state` have the expected shapes and types.

    Raises: CheckpointError for a file that is not a checkpoint, is from another block or method, or has impossible
        content.
    """
    form = [on_host(leaf) for leaf in jax.tree.leaves((unknowns, state))]
    try:
        with zipfile.ZipFile(path) as archive:  # the size in memory is checked before reading
            size = sum(entry.file_size for entry in archive.infolist())
        if size > sum(leaf.nbytes for leaf in form) + _HEADERS * (len(form) + 1):
            raise CheckpointError(f"{path} is the checkpoint of another block, or damaged; {_CURE}")
        with np.load(path, allow_pickle=False) as stored:
            found = str(stored["fingerprint"])
            leaves = [stored[f"leaf {k}"] for k in range(len(stored.files) - 1)]
    except CheckpointError:
        raise
    except (ValueError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise CheckpointError(f"{path} is not a checkpoint; {_CURE}") from error
    if found != mark:
        raise CheckpointError(f"{path} is the checkpoint of another block or method; {_CURE}")
    _require_form(path, leaves, form)
    return jax.tree.unflatten(jax.tree.structure((unknowns, state)), [on_device(leaf) for leaf in leaves])


def _require_form(path: Path, leaves: list[np.ndarray], form: list[np.ndarray]) -> None:
    """Raises CheckpointError for an array with another shape or type than expected, or with infinite values."""
    if len(leaves) != len(form):
        raise CheckpointError(f"{path} contains {len(leaves)} arrays instead of {len(form)}; {_CURE}")
    for k, (leaf, wanted) in enumerate(zip(leaves, form, strict=True)):
        if (leaf.shape, leaf.dtype) != (wanted.shape, wanted.dtype):
            what = f"{leaf.dtype} of shape {leaf.shape} instead of {wanted.dtype} of shape {wanted.shape}"
            raise CheckpointError(f"{path} is damaged: its array {k} is {what}; {_CURE}")
        if not (np.isfinite(leaf) | ~np.isfinite(wanted)).all():
            raise CheckpointError(f"{path} is damaged: its array {k} has a value that is not a finite number; {_CURE}")


class Checkpointer(NamedTuple):
    """Saves the state of one solve in one file."""

    path: Path
    mark: str

    def resumed(self, unknowns: Unknowns, state: Any) -> tuple[Unknowns, Any]:
        """The state to resume from; the given one if there is no file yet.

        In a cluster the first process reads and writes the file.
        """
        if self.path.exists() and is_first_process():
            unknowns, state = load(self.path, self.mark, unknowns, state)
        else:
            self.save(unknowns, state)  # a file that cannot be written is reported before the solve
        return from_first_process((unknowns, state))

    def save(self, unknowns: Unknowns, state: Any) -> None:
        """Saves the current state."""
        if is_first_process():
            save(self.path, self.mark, unknowns, state)
