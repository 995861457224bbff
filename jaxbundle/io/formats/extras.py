"""Packages that only some formats need: they are imported on use; a message names the extra of a missing package."""

import importlib
from typing import Any

from jaxbundle.block.problems import BlockError, Problem

EXTRAS = {
    "pyproj": "gis",
    "pyogrio": "gis",
    "ezdxf": "gis",
    "laspy": "las",
    "lazrs": "las",
    "PIL": "photos",
    "rerun": "rerun",
}
NAMES = {"PIL": "pillow", "rerun": "rerun-sdk"}  # of packages that are not called like their module


def extra(module: str, what: str) -> Any:
    """Imports a module of an optional package; `what` needs it, such as "coordinates in degrees".

    Raises: BlockError with the name of the extra where the package is not installed.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = NAMES.get(package, package)
        cure = f"install it with pip install 'jaxbundle[{EXTRAS[package]}]', or pip install {name}"
        raise BlockError([Problem(f"{what} needs the package {name}, which is not installed", cure)]) from error
