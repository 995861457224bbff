"""Checkpoints: the state of a solve in a file, so that an interrupted one can go on.

The file holds the unknowns in the order of the block and the state of the search, and a fingerprint of everything the
solve depends on. It is written beside its place and moved there: it is never half written.
"""

import hashlib
import os
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbundle.block.block import Block
from jaxbundle.block.unknowns import Unknowns
from jaxbundle.numerics.devices import equal_in_all_processes, from_first_process, is_first_process
from jaxbundle.numerics.host import on_device


class CheckpointError(ValueError):
    """A file that is no checkpoint of this solve."""


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
    """Raises a ValueError where the processes of a cluster do not adjust the same block by the same method."""
    if jax.process_count() > 1 and not equal_in_all_processes(bytes.fromhex(fingerprint(block, method))):
        raise ValueError(
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
    beside = path.with_name(path.name + ".part")
    with beside.open("wb") as file:
        np.savez(file, fingerprint=np.array(mark), **arrays)
    os.replace(beside, path)


def load(path: Path, mark: str, unknowns: Unknowns, state: Any) -> tuple[Unknowns, Any]:
    """The checkpoint's unknowns and state; `unknowns` and `state` give their form.

    Raises: CheckpointError for a file that is none, or one of another block or method.
    """
    cure = "delete it or name another file"
    try:
        with np.load(path, allow_pickle=False) as stored:
            found = str(stored["fingerprint"])
            leaves = [stored[f"leaf {k}"] for k in range(len(stored.files) - 1)]
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} is no checkpoint; {cure}") from error
    if found != mark:
        raise CheckpointError(f"{path} is the checkpoint of another block or method; {cure}")
    return jax.tree.unflatten(jax.tree.structure((unknowns, state)), [on_device(leaf) for leaf in leaves])


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
