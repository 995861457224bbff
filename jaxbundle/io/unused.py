"""Contents of a block folder that the adjustment does not use, with the probable cause.

If no row of control or stations is used, the usual cause is a mistake in names, sigmas or [tables]: without them the
block has a datum that was not intended.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxbundle.block.findings import Finding, Kind, Severity, Subject
from jaxbundle.io.block_tables import REQUIRED, TABLES
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.folder_tables import FolderTables
from jaxbundle.io.known_tables import KnownRows
from jaxbundle.io.near_names import Match, slip
from jaxbundle.io.noted import SUBJECTS, Noted, listed
from jaxbundle.io.observation_tables import unused as unused_names
from jaxbundle.io.settings import Settings
from jaxbundle.io.tables import near, read_table

CARRYING = {"control": "control points", "stations": "stations", "attitudes": "attitudes"}
DATUM = ("control", "stations")
FEW = 10  # maximum number of unmatched names that may be mistakes; more are another list of points
# share of the extent of the object points: control farther from its approximate coordinates is another point
NEAR = 0.05


def unused(
    folder: Path | None, toml: BlockToml, settings: Settings, tables: FolderTables, noted: Noted
) -> tuple[Finding, ...]:
    """Findings about unused contents, one for each cause; `folder`: the folder of the tables, None for frames."""
    found: list[Finding] = []
    for kind in CARRYING:
        if kind in tables.known:
            found += _carrying(kind, tables, settings, noted)
    found += _approximate(tables)
    names = [name for name in settings.cameras if name not in tables.images.camera]
    notes = [f"camera {listed([name])} has no image and is not used" for name in names]
    for kind, owners in tables.owners.items():
        users = [rows for rows in tables.observed.values() if (of := rows.table.schema.owner) and of.table == kind]
        used = [k for rows in users for k in rows.owner.tolist()]
        notes += unused_names(owners.names, used, TABLES[kind].row)
    groups = tables.navigation
    notes += unused_names(
        groups.names, {int(k) for rows in groups.rows.values() for k in rows.group}, "navigation group"
    )
    found += [Finding(Kind.UNUSED, note) for note in notes]
    times = [
        f"times of navigation group {name} count from their mean, {origin:.10g}"
        for name, origin in zip(groups.names, groups.origin.tolist(), strict=True)
        if origin
    ]
    if folder is not None:
        found += _files(folder, toml, settings, tables, noted)
    return (*found, *noted.remarks, *(Finding(Kind.INFORMATION, time) for time in times))


def _takes_part(rows: KnownRows) -> Int[np.ndarray, " row"]:
    return np.flatnonzero((rows.held | rows.observed).any(1))


def _subjects(kind: str, rows: KnownRows, members: Iterable[int] | Int[np.ndarray, " member"]) -> tuple[Subject, ...]:
    return tuple(Subject(kind, (rows.names[row],)) for row in list(members)[:SUBJECTS])


def _grade(settings: Settings) -> Severity | None:
    """Severity: with a datum in block.toml no control is needed, so unused control is only to be checked."""
    return None if settings.datum is None else Severity.CHECK


def _carrying(kind: str, tables: FolderTables, settings: Settings, noted: Noted) -> list[Finding]:
    """The finding about rows of control, stations or attitudes if none of them is used."""
    rows = tables.known[kind]
    meant = np.flatnonzero(~rows.check)
    unseen = np.flatnonzero(rows.position < 0)
    if not len(meant) or len(_takes_part(rows)):
        return _unseen(tables, unseen, noted) if kind == "control" else []
    absent = np.intersect1d(meant, unseen)
    match = near([rows.names[row] for row in absent], _free_points(tables)) if kind == "control" else None
    causes, cures = [], []
    if len(absent):
        they = "it is" if len(meant) == 1 else "they are"
        causes.append(f"{they if len(absent) == len(meant) else f'{len(absent)} of them are'} on no image")
        cures.append(str(match) if match else f"correct the names in {rows.table.file} or {tables.rays.table.file}")
    if len(absent) < len(meant):
        angles = kind == "attitudes"
        unit = settings.units.angle if angles else settings.units.object
        columns = ", ".join(f"s{name}" for name in (tables.angles if angles else "XYZ"))
        causes.append(f"{columns} are empty or belong to coordinates that are empty, so none of them is observed")
        zero = "; 0 fixes a coordinate" if kind == "control" else ""
        cures.append(f"give the standard deviations {columns} in {unit}{zero}")
    noted.touched.update(match.pairs.values() if match else (), (rows.names[row] for row in meant))
    none = "the only row" if len(meant) == 1 else f"none of the {len(meant)} {CARRYING[kind]}"
    takes = "is not used" if len(meant) == 1 else "is used"
    what = f"{none} of {rows.table.file} {takes}: {'; '.join(causes)} ({listed([rows.names[row] for row in meant])})"
    return [Finding(Kind.NOT_USED, what, "; ".join(cures), _subjects(kind, rows, meant), grade=_grade(settings))]


def _free_points(tables: FolderTables) -> list[str]:
    """Points on images that control.csv does not name."""
    named = set(tables.known["control"].names)
    return [name for name in tables.rays.points if name not in named]


def _unseen(tables: FolderTables, unseen: Int[np.ndarray, " row"], noted: Noted) -> list[Finding]:
    """Findings about control or check points on no image: names similar to a point on images are to be checked."""
    rows = tables.known["control"]
    if not len(unseen):
        return []
    names = [rows.names[row] for row in unseen]
    free = _free_points(tables)
    match = near(names, free)
    pairs = dict(match.pairs) if match else {}
    for name in names if len(names) <= FEW else ():
        partner = "" if name in pairs else slip(name, free)
        if partner:
            pairs[name] = partner
    pairs = {name: partner for name, partner in pairs.items() if _in_one_place(tables, name, partner)}
    noted.touched.update(pairs.values())
    found = []
    if pairs:
        words = match.words if match and pairs.keys() <= match.pairs.keys() else ""
        members = [row for row in unseen.tolist() if rows.names[row] in pairs]
        what = _on_no_image("control", list(pairs))
        cure = str(Match(pairs, words, len(pairs)))
        found.append(Finding(Kind.UNUSED, what, cure, _subjects("control", rows, members), grade=Severity.CHECK))
    left = [name for name in names if name not in pairs]
    if left:
        members = [row for row in unseen.tolist() if rows.names[row] not in pairs]
        found.append(Finding(Kind.UNUSED, _on_no_image("control", left), "", _subjects("control", rows, members)))
    return found


def _in_one_place(tables: FolderTables, control: str, partner: str) -> bool:
    """Whether a control point and the approximate coordinates of a point agree; true where either is not known."""
    rows, points = tables.known["control"], tables.known.get("points")
    if points is None or partner not in points.names:
        return True
    a, b = rows.coordinates[rows.names.index(control)], points.coordinates[points.names.index(partner)]
    extent = np.nanmax(points.coordinates, 0) - np.nanmin(points.coordinates, 0)
    distance = np.abs(a - b)[np.isfinite(a) & np.isfinite(b)]
    return bool((distance <= NEAR * extent.max()).all())


def _on_no_image(what: str, names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"{what} point {listed(names)} is on no image and is not used"
    return f"{len(names)} {what} points are on no image and are not used: {listed(names)}"


def _approximate(tables: FolderTables) -> list[Finding]:
    """Approximate coordinates of points on no image."""
    rows = tables.known.get("points")
    unseen = np.flatnonzero(rows.position < 0).tolist() if rows else []
    if not unseen or rows is None:
        return []
    names = [rows.names[row] for row in unseen]
    match = near(names, tables.rays.points) if len(unseen) == len(rows.names) else None
    grade = Severity.CHECK if match else None
    what = _on_no_image("approximate", names)
    return [Finding(Kind.UNUSED, what, str(match) if match else "", _subjects("points", rows, unseen), grade=grade)]


def _files(folder: Path, toml: BlockToml, settings: Settings, tables: FolderTables, noted: Noted) -> list[Finding]:
    """Findings about tables that exist but are not named in [tables]."""
    located = any(len(_takes_part(tables.known[kind])) for kind in DATUM if kind in tables.known)
    found = []
    for kind, schema in TABLES.items():
        file = schema.file
        if kind in REQUIRED or file in toml.tables.values() or not (folder / file).exists():
            continue
        what, cure = f"{file} is not named in [tables] of {FILE} and is not used", f'add {kind} = "{file}" there'
        if kind not in DATUM or kind in toml.tables:
            found.append(Finding(Kind.UNUSED, what))
        elif located or settings.datum is not None:
            found.append(Finding(Kind.UNUSED, what, cure, (Subject(kind),), grade=Severity.CHECK))
        else:
            found.append(Finding(Kind.NOT_USED, what, cure, (Subject(kind),)))
            if kind == "control":
                noted.touched.update(_names_in(folder / file))
    return found


def _names_in(path: Path) -> list[str]:
    """Names of the points of a table of control, as far as it can be read."""
    table = read_table(path, TABLES["control"].only(("point",)), Noted())
    return table.text["point"].to_list() if table else []
