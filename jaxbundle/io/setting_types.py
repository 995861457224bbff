"""Types of the values of block.toml: texts in any case, and numbers of a possible size."""

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from jaxbundle.io.ranges import (
    LARGEST_COEFFICIENT,
    LARGEST_FORMAT,
    LARGEST_IMAGE_COORDINATE,
    LARGEST_LENGTH,
    LARGEST_SIGMA,
    PIXEL_SIZES,
    PRINCIPAL_DISTANCES,
    SMALLEST_PRIOR,
    SMALLEST_SIGMA,
)


def problem(what: str, cure: str) -> PydanticCustomError:
    """An error of a value, in words."""
    return PydanticCustomError("problem", "{what}; {cure}", {"what": what, "cure": cure})


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


def _not_boolean(value: Any) -> Any:
    if isinstance(value, bool):  # true equals 1
        raise PydanticCustomError("literal_error", "a boolean", {"expected": "1"})
    return value


def _within(smallest: float, largest: float) -> AfterValidator:
    """Numbers whose size is between two bounds."""

    def check(value: float) -> float:
        if not smallest <= abs(value) <= largest:
            bounds = {"smallest": f"{smallest:g}", "largest": f"{largest:g}"}
            raise PydanticCustomError("range", "from {smallest} to {largest}", bounds)
        return value

    return AfterValidator(check)


AnyCase = BeforeValidator(_lower)
NotBoolean = BeforeValidator(_not_boolean)
Sigma = Annotated[float, Field(gt=0), _within(SMALLEST_SIGMA, LARGEST_SIGMA)]
Prior = Annotated[float, Field(gt=0), _within(SMALLEST_PRIOR, LARGEST_SIGMA)]
PixelSize = Annotated[float, Field(gt=0), _within(*PIXEL_SIZES)]
PrincipalDistance = Annotated[float, Field(gt=0), _within(*PRINCIPAL_DISTANCES)]
Pixels = Annotated[int, Field(gt=0), _within(1, LARGEST_FORMAT)]
Coefficient = Annotated[float, _within(0, LARGEST_COEFFICIENT)]
Length = Annotated[float, _within(0, LARGEST_LENGTH)]
Pair = Annotated[list[Annotated[float, _within(0, LARGEST_IMAGE_COORDINATE)]], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Length], Field(min_length=3, max_length=3)]
