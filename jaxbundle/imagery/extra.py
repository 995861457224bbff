"""Packages of the extra `measure`: they are loaded when they are used, and a message names the extra where they are not
there."""

import importlib
from typing import Any

PACKAGES = {
    "cv2": "opencv-python-headless",
    "tifffile": "tifffile",
    "PIL.Image": "pillow",
    "PIL.ExifTags": "pillow",
}


class MissingExtraError(ImportError):
    """A package of the extra `measure` is not installed."""

    def __init__(self, module: str):
        package = PACKAGES.get(module, module)
        super().__init__(
            f"reading and measuring photographs needs the package {package}, which is not installed;"
            " install the extra: pip install 'jaxbundle[measure]'"
        )


def required(module: str) -> Any:
    """A module of the extra `measure`.

    Raises: MissingExtraError where it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(module) from error
