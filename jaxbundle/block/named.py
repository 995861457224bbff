"""Points, images and cameras by name, with their values and standard deviations.

block.points["20"].coordinates
result.points["20"].standard_deviations
result.cameras["c"]["K1"]
"""

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from jaxtyping import Array, Float

from jaxbundle.block.problems import shown

T = TypeVar("T")
FIRST = 5  # maximum number of names in a representation


class Named(Mapping[str, T], Generic[T]):
    """Members of a block by name, created on access; iteration is in the order of the arrays."""

    def __init__(self, what: str, names: Sequence[str], make: Callable[[int], T]):
        self._what, self._names, self._make = what, names, make
        self._index = {name: k for k, name in enumerate(names)}

    def __getitem__(self, name: str) -> T:
        if name not in self._index:
            raise UnknownNameError(self._what, name, self._names)
        return self._make(self._index[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        more = ", ..." if len(self) > FIRST else ""
        return f"<{len(self)} {self._what}s: {', '.join(map(shown, self._names[:FIRST]))}{more}>"


class UnknownNameError(KeyError):
    """The error for a name that is not in the block, with similar names."""

    def __init__(self, what: str, name: object, known: Sequence[str]):
        near = difflib.get_close_matches(str(name), known, n=3)
        cure = f"did you mean {' or '.join(map(repr, near))}?" if near else f"the block has {len(known)} {what}s"
        text = f"there is no {what} {shown(repr(name))}; {cure}"
        if not isinstance(name, str):
            text += f"; names are text: {str(name)!r}"
        super().__init__(text)

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class PointValues:
    """An object point with its precision. Standard deviations and covariance are None if not computed."""

    name: str
    coordinates: Float[Array, "3"]
    """X, Y, Z in the object unit."""
    standard_deviations: Float[Array, "3"] | None = None
    """Standard deviations of X, Y, Z; 0 for a fixed coordinate."""
    covariance: Float[Array, "3 3"] | None = None
    """Covariance matrix sigma0^2 Q of X, Y, Z."""


@dataclass(frozen=True)
class ImageValues:
    """The exterior orientation of an image."""

    name: str
    camera: str
    """Name of its camera."""
    projection_centre: Float[Array, "3"]
    """X0, Y0, Z0 in the object unit."""
    angles: Float[Array, "3"]
    """The three angles of the block's rotation system, in radians."""
    standard_deviations: Float[Array, "6"] | None = None
    """Standard deviations of X0, Y0, Z0 and the angles in radians; 0 for a fixed element."""
    covariance: Float[Array, "6 6"] | None = None
    """Covariance matrix sigma0^2 Q of X0, Y0, Z0 and the angles."""


class CameraValues(Mapping[str, Any]):
    """Interior elements of a camera by name: `camera["K1"]`."""

    def __init__(self, name: str, elements: Sequence[str], units: Sequence[str], values: Any, deviations: Any = None):
        self.name = name
        """Name of the camera."""
        self.units = dict(zip(elements, units, strict=True))
        """Unit of each element, "" without unit."""
        self._elements = tuple(elements)
        self._values, self._deviations = values, deviations

    def __getitem__(self, element: str) -> Any:
        return self._values[self._number(element)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._elements)

    def __len__(self) -> int:
        return len(self._elements)

    def __repr__(self) -> str:
        return f"<camera {shown(self.name)}: {', '.join(self._elements)}>"

    @property
    def standard_deviations(self) -> dict[str, Any] | None:
        """Standard deviations of the elements, 0 for a fixed one; None if not computed."""
        if self._deviations is None:
            return None
        return {element: self._deviations[k] for k, element in enumerate(self._elements)}

    def _number(self, element: str) -> int:
        if element not in self._elements:
            raise UnknownNameError(f"element of camera {shown(self.name)}:", element, self._elements)
        return self._elements.index(element)
