"""Checking the first argument of a public function, with a message of one sentence and its cure."""

from pathlib import Path

from jaxbundle.block.block import Block


def require_a(kind: type, given: object, function: str) -> None:
    """Raises TypeError unless the first argument of a public function has the expected type, such as Block."""
    if isinstance(given, kind):
        return
    path = f"jb.read({str(given)!r})" if isinstance(given, str | Path) else 'jb.read("folder")'
    if isinstance(getattr(given, "block", None), kind):
        name = type(given).__name__.lower()
        cure = f"{name}.block"  # attribute of an Adjustment or a Simulation
    elif kind.__name__ == "Block":
        cure = path
    elif type(given).__name__ == "Block":
        cure = "jb.adjust(block)"
    else:
        cure = f"jb.adjust({path})"
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    what = "None" if given is None else f"{given!r}" if isinstance(given, str) else type(given).__name__
    raise TypeError(f"{function} takes {article} {kind.__name__}, not {what}: call jb.{function}({cure})")


def require_photographs(block: Block, function: str) -> None:
    """Raises ValueError unless the rays of a block are image points, for functions limited to photographs."""
    model = block.structure.model
    if not model.photographs:
        raise ValueError(
            f"{function} takes photographs only; the sensor {model.name!r} of this block gives {model.components}"
            " residuals per point. jb.adjust, jb.covariance_of, jb.statistics.reliability and"
            " jb.statistics.error_ellipses take any sensor"
        )
