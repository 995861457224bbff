"""Ranges of the numbers of a block, and the types of the values of block.toml.

A number outside its range is a mistake or in another unit, and its square or weight may overflow in float64.
"""

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

MAX_LENGTH = 1e12  # m or mm, or px: 150 times the earth's radius in mm; there double precision resolves 0.1 mm
MAX_IMAGE_COORDINATE = 1e9  # px or mm: a thousand times the largest mosaics
MAX_TIME = 1e16  # any unit: nanoseconds of several months, microseconds since 1970
# coefficients of distortion, any unit: balanced terms in mm are below 1e-3, and no coefficient exceeds 1e3
MAX_COEFFICIENT = 1e12
MAX_COVARIANCE = MAX_LENGTH**2
TURNS = 100  # of an angle: nobody counts full turns
SMALLEST_SIGMA = 1e-15  # m, mm, px or rad: its weight 1/sigma^2 of 1e30 exceeds any other by more than 16 digits
MAX_SIGMA = MAX_LENGTH
SMALLEST_PRIOR = 1e-60  # of a coefficient in px, K3: the inverse sixth power of some thousand px, with some digits
PRINCIPAL_DISTANCES = (1e-6, 1e9)  # mm, px, or of normalised image coordinates
PIXEL_SIZES = (1e-6, 1e3)  # mm: 1 nm to 1 m
MAX_FORMAT = 10**8  # px
NOTHING = 1e-200  # a smaller number that is not 0 is a mistake: its square is 0


def beyond(value: float, smallest: float, largest: float) -> str:
    """Why a positive number is out of range, to follow the number in a sentence; "" where it is within."""
    if smallest <= value <= largest:
        return ""
    return f"is {value:g}, not between {smallest:g} and {largest:g}"


def largest_angle(half_turn: float) -> float:
    """The maximum angle in a unit with this half turn."""
    return 2 * TURNS * half_turn


def problem(what: str, cure: str) -> PydanticCustomError:
    """A validation error of a value with problem and cure."""
    return PydanticCustomError("problem", "{what}; {cure}", {"what": what, "cure": cure})


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


def _not_boolean(value: Any) -> Any:
    if isinstance(value, bool):  # true equals 1
        raise PydanticCustomError("literal_error", "a boolean", {"expected": "1"})
    return value


def _within(smallest: float, largest: float) -> AfterValidator:
    """Numbers whose magnitude is between two bounds."""

    def check(value: float) -> float:
        if not smallest <= abs(value) <= largest:
            bounds = {"smallest": f"{smallest:g}", "largest": f"{largest:g}"}
            raise PydanticCustomError("range", "from {smallest} to {largest}", bounds)
        return value

    return AfterValidator(check)


AnyCase = BeforeValidator(_lower)
NotBoolean = BeforeValidator(_not_boolean)
Sigma = Annotated[float, Field(gt=0), _within(SMALLEST_SIGMA, MAX_SIGMA)]
Prior = Annotated[float, Field(gt=0), _within(SMALLEST_PRIOR, MAX_SIGMA)]
PixelSize = Annotated[float, Field(gt=0), _within(*PIXEL_SIZES)]
PrincipalDistance = Annotated[float, Field(gt=0), _within(*PRINCIPAL_DISTANCES)]
Pixels = Annotated[int, Field(gt=0), _within(1, MAX_FORMAT)]
Coefficient = Annotated[float, _within(0, MAX_COEFFICIENT)]
Length = Annotated[float, _within(0, MAX_LENGTH)]
Pair = Annotated[list[Annotated[float, _within(0, MAX_IMAGE_COORDINATE)]], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Length], Field(min_length=3, max_length=3)]
