"""Folders with the mistakes that people make, from the collection beside the real blocks."""

import importlib.util
from pathlib import Path


def made(shared_data: Path, mistake: str, folder: Path) -> Path:
    """A block folder with a mistake, by the first letters of its name."""
    spec = importlib.util.spec_from_file_location("user_mistakes", shared_data / "cases" / "user_mistakes.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (name,) = (name for name in module.M if name.startswith(f"{mistake}_"))
    block = module.B()
    module.M[name](block)
    block.save(folder / name)
    return folder / name
