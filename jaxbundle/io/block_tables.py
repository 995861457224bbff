"""Descriptions of all tables of the block folder, format 1.

To add a kind of observation, add one entry to `TABLES`: its columns, and a function that returns the kind with
its residual (block/observation_kinds.py). Tables with `plain=True` are read, checked and written without further code.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from jaxbundle.block.geodetic import LINES, PLANES, geodetic_kind
from jaxbundle.block.observation_kinds import CONTROL, STATIONS, ObservationKind
from jaxbundle.io.schema import Column, Holds, OwnerSchema, TableSchema, Unit, called

COORDINATES = ("X", "Y", "Z")
REQUIRED = ("images", "rays")
OTHER_NAMES = {  # names of columns in files of other programs: letters and digits in lower case
    "image": "photo picture img foto bild file filename photoid imageid imagename label",
    "camera": "cam kamera cameraid sensor",
    "point": "pt id name no nr number pointid pointname punkt gcp marker label",
    "X0": "e easting east x xo xc longitude rechts",
    "Y0": "n northing north y yo yc latitude hoch",
    "Z0": "h height z zo zc alt altitude elevation up hoehe",
    "X": "e easting east x0 longitude rechts",
    "Y": "n northing north y0 latitude hoch",
    "Z": "h height z0 alt altitude elevation up hoehe",
    "x": "u col column px xpx imagex xi",
    "y": "v row line py ypx imagey eta",
    "sX": "sigmax sdx stdx se sigmae stde accuracyx mx",
    "sY": "sigmay sdy stdy sn sigman stdn accuracyy my",
    "sZ": "sigmaz sdz stdz sh su sigmah stdh accuracyz mz",
    "sx": "sigmax sdx stdx su sigmau",
    "sy": "sigmay sdy stdy sv sigmav",
    "omega": "roll om w",
    "phi": "pitch ph p",
    "kappa": "yaw heading ka k",
    "sigma": "sd std s accuracy",
    "role": "type use kind status",
}


GIVE = "give a number or drop the row"
POSITIVE = "give a positive number"
APPROXIMATE = (
    "give approximate values, such as from GNSS, the flight plan or a map, with errors below some percent of the height"
)
IN_OBJECT_UNIT = "add them, in the object unit: 0 fixes a coordinate, an empty field means that it is not observed"
NOT_HELD = f"{POSITIVE}; to fix elements of images use [datum] in block.toml"

_TEXT = partial(Column, holds=Holds.TEXT)
_OWNER = partial(Column, holds=Holds.OWNER)
_LENGTH, _ANGLE = partial(Column, unit=Unit.OBJECT), partial(Column, unit=Unit.ANGLE)
_SIGMA = partial(Column, holds=Holds.SIGMA, unit=Unit.OBJECT)
_COVARIANCE = partial(Column, holds=Holds.OTHER, unit=Unit.OBJECT_SQUARED)
_COLUMNS = (
    Column("image", Holds.IMAGE),
    Column("point", Holds.POINT),
    *(Column(name, Holds.END) for name in ("from", "to")),
    _TEXT("camera", missing="add it, with the name of a camera of block.toml in each row"),
    *(_LENGTH(name, empty=APPROXIMATE, missing=APPROXIMATE) for name in ("X0", "Y0", "Z0")),
    *(_ANGLE(f"{{{k}}}") for k in range(3)),
    *(_SIGMA(f"s{{{k}}}", unit=Unit.ANGLE, zero=NOT_HELD) for k in range(3)),
    *(_LENGTH(name) for name in COORDINATES),
    *(_SIGMA(f"s{name}", missing=IN_OBJECT_UNIT) for name in COORDINATES),
    *(_COVARIANCE(name) for name in ("cXY", "cXZ", "cYZ")),
    *(Column(name, unit=Unit.RAYS, empty=GIVE) for name in ("x", "y")),
    *(_SIGMA(f"s{name}", unit=Unit.RAYS, zero=f"{POSITIVE}, or leave it empty for the default") for name in "xy"),
    _TEXT("role", missing="add it, with control or check in each row"),
    *(_TEXT(name) for name in ("category", "fiducial")),
    *(_OWNER(name) for name in ("group", "set", "bar", "line", "plane")),
    Column("time", Holds.OTHER, Unit.TIME),
    _LENGTH("distance", empty=GIVE, positive=f"{POSITIVE} or drop the row"),
    _LENGTH("difference", empty=GIVE),
    _LENGTH("length", empty=GIVE, positive=f"{POSITIVE}, approximate where sigma is empty"),
    *(_ANGLE(name, empty=GIVE) for name in ("azimuth", "direction")),
    _ANGLE("angle", empty=GIVE, first_face="reduce it to the first face, or drop the row"),
    _SIGMA("sigma", empty=GIVE, zero=POSITIVE, missing="add it, the standard deviation in the unit of the values"),
)
COLUMNS: dict[str, Column] = {column.name: column for column in _COLUMNS}


def _columns(names: str, **changes) -> tuple[Column, ...]:
    """The columns with these names; those in brackets are optional. `changes` apply to all of them."""
    return tuple(replace(COLUMNS[n.strip("[]")], optional=n[0] == "[", **changes) for n in names.split())


def _pair(name: str, value: str, meaning: str, owner: OwnerSchema | None = None, column: str = "") -> TableSchema:
    """A table of observations from one point or image to another; `column` names the common owner of rows."""
    unit = COLUMNS[value].unit if value else Unit.OBJECT
    columns = (*_columns(f"{column} from to {value}"), *_columns("sigma", unit=unit))
    subject = f"{called(name)} {{from}} - {{to}}" + (f" of {column} {{{column}}}" if column else "")
    return TableSchema(name, subject, columns, meaning, partial(geodetic_kind, name), plain=True, owner=owner)


def _figure(
    name: str, column: str, meaning: str, kind: Callable[..., ObservationKind], owner: OwnerSchema
) -> TableSchema:
    """A table of points on common figures; each point is observed with one standard deviation."""
    columns, subject = _columns(f"{column} point sigma"), f"point {{point}} of {called(name)} {{{column}}}"
    return TableSchema(name, subject, columns, meaning, kind, plain=True, owner=owner)


_SCHEMAS = (
    TableSchema(
        "images",
        "image {image}",
        (*_columns("image camera X0 Y0 Z0"), *_columns("{0} {1} {2}", empty=APPROXIMATE)),
        "approximate values; an empty centre or attitude is computed from the rays",
    ),
    TableSchema(
        "rays",
        "point {point} on image {image}",
        _columns("image point x y [sx] [sy]"),
        "empty sx, sy: the default sigma",
    ),
    TableSchema(
        "points",
        "point {point}",
        _columns("point X Y Z"),
        "approximate; missing values come from the control, else from forward intersection",
    ),
    TableSchema(
        "control",
        "point {point}",
        _columns("point X Y Z sX sY sZ role [cXY] [cXZ] [cYZ] [category]"),
        "`control`: sigma 0 fixes the coordinate, empty: not observed; else weighted; `check`: unused; cXY, cXZ, cYZ: "
        "covariances; category: one of [identification]",
        lambda *_: CONTROL,
    ),
    TableSchema(
        "stations",
        "image {image}",
        (*_columns("image X Y Z"), *_columns("sX sY sZ", zero=NOT_HELD), *_columns("[group] [time]")),
        "observed projection centres; group: a section [navigation.NAME]",
        lambda *_: STATIONS,
        systematic=("lever_arm", "shift", "drift"),
    ),
    TableSchema(
        "attitudes",
        "image {image}",
        _columns("image {0} {1} {2} s{0} s{1} s{2} [group] [time]"),
        "observed attitudes",
        systematic=("boresight", "attitude_shift", "attitude_drift"),
    ),
    _pair("distances", "distance", "in space"),
    _pair("horizontal_distances", "distance", "in the XY plane"),
    _pair("height_differences", "difference", "Z of `to` minus Z of `from`"),
    _pair("azimuths", "azimuth", "clockwise from +Y"),
    _pair("zenith_angles", "angle", "in the first face"),
    _pair(
        "directions",
        "direction",
        "an unknown orientation for each set, which has one station",
        OwnerSchema((("orientation", Unit.ANGLE),), same="from"),
        "set",
    ),
    _pair("scale_bars", "", "position of the bar", OwnerSchema((("length", Unit.OBJECT),), table="bars"), "bar"),
    TableSchema(
        "bars",
        "bar {bar}",
        (*_columns("bar", holds=Holds.TEXT), *_columns("length"), *_columns("sigma", empty="", zero="")),
        "lengths of scale bars; sigma: 0 fixes the length, empty means unknown, else observed",
    ),
    _figure(
        "plumb_lines",
        "line",
        "horizontal differences of each point to the first one of its line, whose sigma is empty",
        lambda *_: geodetic_kind("plumb_lines"),
        OwnerSchema(min_rows=2),
    ),
    _figure(
        "planes",
        "plane",
        "distances to a common plane, which is unknown",
        lambda *_: PLANES,
        OwnerSchema((("a", Unit.NONE), ("b", Unit.NONE), ("d", Unit.OBJECT)), min_rows=3),
    ),
    _figure(
        "lines",
        "line",
        "distances to a common line, which is unknown",
        lambda *_: LINES,
        OwnerSchema((("a", Unit.NONE), ("b", Unit.NONE), ("p", Unit.OBJECT), ("q", Unit.OBJECT)), min_rows=2),
    ),
    TableSchema(
        "fiducials",
        "fiducial {fiducial} of camera {camera}",
        (*_columns("camera fiducial"), *_columns("x y", unit=Unit.MM)),
        "calibrated",
    ),
    TableSchema(
        "fiducial_rays",
        "fiducial {fiducial} on image {image}",
        (*_columns("image fiducial"), *_columns("x y", unit=Unit.PX)),
        "measured on the scanned film",
    ),
)
TABLES: dict[str, TableSchema] = {schema.name: schema for schema in _SCHEMAS}


def table_of_kind() -> dict[ObservationKind, TableSchema]:
    """The table of each kind of observation that is read and written by its columns only."""
    return {kind: schema for schema in TABLES.values() if schema.plain for kind in schema.kinds()}


def format_tables() -> str:
    """The tables of the format as a table in Markdown; columns in brackets may be absent."""
    lines = ["| table | columns | meaning |", "|---|---|---|"]
    for schema in TABLES.values():
        columns = ",".join(f"[{c.words}]" if c.optional else c.words for c in schema.columns)
        lines.append(f"| {schema.name} | {columns} | {schema.meaning} |")
    return "\n".join(lines) + "\n"


def format_columns() -> str:
    """All columns of all tables in Markdown: content, its unit, and whether it may be absent, empty or 0."""
    lines: list[str] = []
    for schema in TABLES.values():
        lines += ["", f"### {schema.name}.csv", "", f"{schema.meaning[0].upper()}{schema.meaning[1:]}.", ""]
        lines += ["| column | content | unit | may be |", "|---|---|---|---|"]
        lines += [f"| {c.words} | {c.holds.value} | {c.unit.words} | {', '.join(c.may_be)} |" for c in schema.columns]
    return "\n".join(lines[1:]) + "\n"
