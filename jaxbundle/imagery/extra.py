"""Packages of the extra `measure`, imported on use; a message names the extra of a missing package."""

import importlib
from typing import Any

PACKAGES = {
    "cv2": "opencv-python-headless",
    "tifffile": "tifffile",
    "PIL.Image": "pillow",
    "PIL.ExifTags": "pillow",
}


class MissingExtraError(ImportError):
    """The error for a package of the extra `measure` that is not installed."""

    def __init__(self, module: str):
        package = PACKAGES.get(module, module)
        super().__init__(
            f"reading and measuring photographs needs the package {package}, which is not installed;"
            " install the extra: pip install 'jaxbundle[measure]'"
        )


def required(module: str) -> Any:
    """Imports a module of the extra `measure`.

    Raises: MissingExtraError if it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(module) from error
