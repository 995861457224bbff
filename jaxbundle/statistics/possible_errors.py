"""All hypotheses about a block: the tested errors of its observations, and their columns."""

from collections.abc import Iterable, Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from jaxbundle.block.block import Block
from jaxbundle.block.findings import Subject
from jaxbundle.block.observation_kinds import ObservationGroup
from jaxbundle.numerics.host import on_device
from jaxbundle.statistics.error_columns import FIXED, ErrorColumn
from jaxbundle.statistics.hypotheses import (
    ANGLE_TABLES,
    Cause,
    Hypotheses,
    Hypothesis,
    image_points,
    subject_of,
    unit_of,
)

RAYS = 40  # rays with the largest |w| that are tested: an error rarely increases that of more neighbours
MEMBERS = 120  # rows of one table that are tested, those with the largest |w|
IMAGES = 8  # images whose rays are tested as a whole: those with the largest mean w^2
FEWEST_RAYS = 4  # minimum rays of an image or camera that is tested as a whole: scale and shift are 3 numbers
FEWEST_ALIKE = 3  # minimum rows of images with a common prefix of their names that are tested as a group
WIDEST = 3e7  # rays times columns of images: above this, only single rays are tested
FEWEST_COLUMNS, MAX_COLUMNS = 60, 500
NUMBERS = 3e7  # elements of all columns times all unknowns: 240 MB
NEAR_POINTS = 1000  # number of pairs of control points that are tested for exchanged names
SCALED = (
    "distances",
    "horizontal_distances",
    "scale_bars",
)  # tables in which a wrong unit or scale has a common effect


def possible_errors(block: Block, w: Sequence[np.ndarray], computed: Sequence[np.ndarray]) -> Hypotheses:
    """Makes the hypotheses about the observations of a block.

    `w`: tables of its standardised residuals, which select the most suspect ones if there are many; `computed`:
    values of the groups of observations that follow from the adjusted unknowns (`computed_values`).
    """
    return _Collection(block, [np.abs(np.nan_to_num(table, nan=0.0)) for table in w], computed).everything()


def computed_values(block: Block, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Computed values (observed + residual) for each group of observations, from the tables of weighted residuals."""
    return [
        np.asarray(group.values) + np.asarray(group.unweighted(on_device(v)))
        for group, v in zip(block.groups, residuals[1:], strict=True)
    ]


class _Collection:
    """Collects columns and hypotheses."""

    def __init__(self, block: Block, w: list[np.ndarray], computed: Sequence[np.ndarray]):
        self.block, self.w, self.computed, self.s = block, w, computed, block.structure
        self.columns: list[ErrorColumn] = []
        self.combinations: list[tuple[Int[np.ndarray, " _entry"], Float[np.ndarray, " _entry"]]] = []
        self.found: list[Hypothesis] = []
        self.at: dict[tuple[int, int], dict[int, int]] = {}  # table, member -> component -> column
        self.room = int(np.clip(NUMBERS / max(self.s.n_unknowns, 1), FEWEST_COLUMNS, MAX_COLUMNS))

    def everything(self) -> Hypotheses:
        """Returns all hypotheses."""
        self._control()
        for k, group in enumerate(self.block.groups, 1):
            if not _is_control(group):
                self._members(k, group)
        self._rays()
        self._groups()
        self._scales()
        self._images()
        self._exchanged()
        places = [np.full(len(rows), k) for k, (rows, _) in enumerate(self.combinations)]
        values = np.concatenate([v for _, v in self.combinations])
        rows = np.concatenate([r for r, _ in self.combinations])
        shape = (len(self.columns), len(self.combinations))
        combinations = sp.csc_matrix((values, (rows, np.concatenate(places))), shape)
        rows = len(self.s.ray_image) + sum(len(group.structure.indices) for group in self.block.groups)
        return Hypotheses(tuple(self.found), tuple(self.columns), combinations, self.block.n_observations + rows)

    # columns

    def _elementary(self, column: ErrorColumn) -> int:
        self.columns.append(column)
        return self._combined({len(self.columns) - 1: 1.0})

    def _combined(self, parts: dict[int, float]) -> int:
        """Adds a column made from elementary ones."""
        self.combinations.append((np.array(list(parts), int), np.array(list(parts.values()), float)))
        return len(self.combinations) - 1

    def _single(self, table: int, member: int, components: Iterable[int]) -> dict[int, int]:
        """Columns of some components of a row, for each component; made once."""
        own = self.at.setdefault((table, member), {})
        for k in components:
            if k not in own:
                own[k] = self._elementary(ErrorColumn(table, np.array([member]), np.array([k]), np.ones(1)))
        return own

    def _parts(self, column: int, factor: float) -> dict[int, float]:
        rows, values = self.combinations[column]
        return {int(r): factor * float(v) for r, v in zip(rows, values, strict=True)}

    # hypotheses

    def _add(
        self,
        subject: Subject,
        columns: Sequence[int],
        components: Sequence[str],
        unit: str,
        members: Iterable[tuple[int, int]],
    ) -> None:
        """Adds a row as a whole and, if it has several components, each component."""
        covered, units = frozenset(members), (unit,) * len(columns)
        self.found.append(Hypothesis((subject,), Cause.VALUE, tuple(columns), tuple(components), units, covered))
        if len(columns) > 1:
            self.found += [
                Hypothesis(
                    (subject._replace(component=name),), Cause.VALUE, (column,), (name,), (unit,), covered, False
                )
                for column, name in zip(columns, components, strict=True)
            ]

    def _control(self) -> None:
        """Adds control points with observed or fixed coordinates."""
        s, tables = self.s, [k for k, group in enumerate(self.block.groups, 1) if _is_control(group)]
        fixed = ~s.point_free
        rays = np.bincount(s.ray_point, minlength=len(s.point_names))
        score = np.where(fixed.any(1) & (rays > 0), 1e-9, 0.0)
        np.maximum.at(score, s.ray_point, np.where(score[s.ray_point] > 0, self.w[0].max(1), 0.0))
        place: dict[int, list[tuple[int, int]]] = {}
        for k in tables:
            g = self.block.groups[k - 1].structure
            for row in np.flatnonzero(g.observed.any(1)).tolist():
                point = int(g.indices[row, 0])
                place.setdefault(point, []).append((k, row))
                score[point] = max(score[point], self.w[k][row].max(), 1e-9)
        for point in _largest(score, min(MEMBERS, self.room // 4)).tolist():
            columns: dict[int, int] = {}
            members = [(FIXED, point)] if fixed[point].any() and rays[point] else []
            if members:
                columns |= self._single(FIXED, point, np.flatnonzero(fixed[point]).tolist())
            for k, row in place.get(point, []):
                observed = np.flatnonzero(self.block.groups[k - 1].structure.observed[row]).tolist()
                columns |= self._single(k, row, observed)
                members.append((k, row))
            order = sorted(columns)
            names = ["XYZ"[c] for c in order]
            subject = Subject("control", (s.point_names[point],))
            self._add(subject, [columns[c] for c in order], names, s.object_unit, members)

    def _members(self, table: int, group: ObservationGroup) -> None:
        """Adds rows of any other table."""
        observed = group.structure.observed
        score = np.where(observed.any(1), self.w[table].max(1, initial=0.0) + 1e-9, 0.0)
        for row in _largest(score, min(MEMBERS, self.room // 8)).tolist():
            components = np.flatnonzero(observed[row]).tolist()
            columns = self._single(table, row, components)
            names = [group.structure.kind.components[c] for c in components]
            subject = subject_of(self.block, table, row)
            unit = unit_of(self.block, table, row)
            self._add(subject, [columns[c] for c in components], names, unit, [(table, row)])

    def _rays(self) -> None:
        for ray in _largest(self.w[0].max(1, initial=0.0), min(RAYS, self.room // 4)).tolist():
            columns = self._single(0, ray, (0, 1))
            self._add(
                subject_of(self.block, 0, ray), [columns[0], columns[1]], "xy", unit_of(self.block, 0, ray), [(0, ray)]
            )

    def _groups(self) -> None:
        """Adds a common shift of all control, and of all rows of a table that share their systematic errors."""
        tables: dict[str, list[tuple[str, list[tuple[int, int]]]]] = {}
        s = self.s
        control = [(FIXED, p) for p in np.flatnonzero(~s.point_free.all(1)).tolist()]
        control += [
            (k, row)
            for k, group in enumerate(self.block.groups, 1)
            if _is_control(group)
            for row in np.flatnonzero(group.structure.observed.any(1)).tolist()
        ]
        tables["control"] = [("", control)]
        for k, group in enumerate(self.block.groups, 1):
            name = group.structure.kind.table
            if name in ("stations", "attitudes"):
                tables.setdefault(name, [])
                tables[name] += [(of, [(k, r) for r in rows]) for of, rows in _sharing(self.block, group)]
        for table, sets in tables.items():
            for name, members in sets:
                self._shifted(Subject("navigation", (name,)) if name else Subject(table), table, members)

    def _shifted(self, subject: Subject, table: str, members: list[tuple[int, int]]) -> None:
        """Adds a common shift of some rows, as a whole and by component."""
        columns, names, covered = [], [], frozenset(members)
        if len(covered) < 2:
            return
        by_table: dict[int, list[int]] = {}
        for k, row in members:
            by_table.setdefault(k, []).append(row)
        labels = ("X", "Y", "Z")
        for axis in range(3):
            parts: dict[int, float] = {}
            for k, rows in by_table.items():
                if k == FIXED:
                    mask = ~self.s.point_free[rows, axis]
                else:
                    structure = self.block.groups[k - 1].structure
                    mask, labels = structure.observed[rows, axis], structure.kind.components
                if mask.any():
                    at = np.array(rows)[mask]
                    self.columns.append(ErrorColumn(k, at, np.full(len(at), axis), np.ones(len(at))))
                    parts[len(self.columns) - 1] = 1.0
            if parts:
                columns.append(self._combined(parts))
                names.append(labels[axis])
        unit = self.s.angle_unit if table in ANGLE_TABLES else self.s.object_unit
        units = (unit,) * len(columns)
        if not columns:
            return
        self.found.append(Hypothesis((subject,), Cause.SHIFT, tuple(columns), tuple(names), units, covered))
        if len(columns) > 1:
            self.found += [
                Hypothesis((subject._replace(component=n),), Cause.SHIFT, (c,), (n,), (unit,), covered, False)
                for c, n in zip(columns, names, strict=True)
            ]

    def _scales(self) -> None:
        """Adds a common factor of the distances of one table, and of bars that are used several times."""
        for k, group in enumerate(self.block.groups, 1):
            structure = group.structure
            if structure.kind.name not in SCALED or len(structure.indices) < 2:
                continue
            rows = np.arange(len(structure.indices))
            if structure.kind.name == "scale_bars":
                lengths = np.asarray(self.block.parameters)[structure.indices[:, 2]]
                for bar in dict.fromkeys(structure.indices[:, 2].tolist()):
                    of_bar = rows[structure.indices[:, 2] == bar]
                    if len(of_bar) > 1:
                        parameter = self.s.parameters[bar]
                        name = parameter.owner.name if parameter.owner else parameter.name
                        self._alike(Subject("bars", (name,)), Cause.SHIFT, k, of_bar, np.ones(len(of_bar)))
            else:
                # not the observed ones: a gross error of one of them is not a common scale
                lengths = self.computed[k - 1][:, 0]
            self._alike(Subject(structure.kind.name), Cause.SCALE, k, rows, lengths)

    def _alike(self, subject: Subject, cause: Cause, table: int, rows: np.ndarray, values: np.ndarray) -> None:
        """Adds members of a table with one component whose errors are a common number times some values."""
        column = self._elementary(ErrorColumn(table, rows, np.zeros(len(rows), int), values))
        unit = "" if cause is Cause.SCALE else self.s.object_unit
        name = "scale" if cause is Cause.SCALE else "length"
        covered = frozenset((table, row) for row in rows.tolist())
        self.found.append(Hypothesis((subject,), cause, (column,), (name,), (unit,), covered))

    def _images(self) -> None:
        """Adds a wrong scale of the image coordinates of an image, or of a camera with several images."""
        s, rays = self.s, len(self.s.ray_image)
        count = np.bincount(s.ray_image, minlength=len(s.image_names))
        square = np.bincount(s.ray_image, (self.w[0] ** 2).sum(1), minlength=len(s.image_names))
        score = np.where(count >= FEWEST_RAYS, square / np.maximum(count, 1), 0.0)
        if rays * 3 * (IMAGES + len(s.cameras)) > WIDEST:
            return
        for image in _largest(score, IMAGES).tolist():
            self._scaled(Subject("images", (s.image_names[image],)), s.ray_image == image)
        used = np.bincount(s.image_camera, minlength=len(s.cameras))
        held = [
            not free[c.model.elements.index("principal_distance")]
            for c, free in zip(s.cameras, s.interior_free, strict=True)
        ]
        for camera in np.flatnonzero((used > 1) & held)[:IMAGES].tolist():
            self._scaled(Subject("cameras", (s.cameras[camera].name,)), s.image_camera[s.ray_image] == camera)

    def _scaled(self, subject: Subject, chosen: Bool[np.ndarray, " ray"]) -> None:
        ray = np.flatnonzero(chosen)
        if len(ray) < FEWEST_RAYS:
            return
        point = image_points(self.block)[ray]
        centre = point.mean(0)
        # a shift of all image points is hardly separable from a rotation of the image
        column = self._elementary(
            ErrorColumn(0, np.repeat(ray, 2), np.tile([0, 1], len(ray)), (point - centre).ravel())
        )
        members = frozenset((0, r) for r in ray.tolist())
        self.found.append(Hypothesis((subject,), Cause.IMAGE, (column,), ("scale",), ("",), members))

    # mistakes of known size

    def _exchanged(self) -> None:
        """Adds exchanges: names of two control points or two rays of an image; X and Y of a point, x and y of a ray."""
        control = [h for h in self.found if h.whole and h.cause is Cause.VALUE and h.subjects[0].table == "control"]
        rays = [h for h in self.found if h.whole and h.cause is Cause.VALUE and h.subjects[0].table == "rays"]
        places = {id(h): self._given(h) for h in (*control, *rays)}
        for h in (*control, *rays):
            given = places[id(h)]
            first, second = ("X", "Y") if h in control else ("x", "y")
            if first in given and second in given:
                difference = given[first][1] - given[second][1]
                self._mistake((h,), Cause.AXES, [(given[first][0], difference), (given[second][0], -difference)])
        pairs = [(a, b) for k, a in enumerate(control) for b in control[:k]][:NEAR_POINTS]
        pairs += [
            (a, b) for k, a in enumerate(rays) for b in rays[:k] if a.subjects[0].names[0] == b.subjects[0].names[0]
        ]
        for a, b in pairs:
            one, two = places[id(a)], places[id(b)]
            if set(one) == set(two):
                parts = [(one[n][0], one[n][1] - two[n][1]) for n in one] + [
                    (two[n][0], two[n][1] - one[n][1]) for n in one
                ]
                self._mistake((a, b), Cause.NAMES, parts)

    def _given(self, h: Hypothesis) -> dict[str, tuple[int, float]]:
        """Column and given value of each component, in the frame of the residuals, rays as they were measured."""
        table, member = next(iter(h.members))
        if table == 0:
            values = np.asarray(self.block.rays.coordinates)[member]
            return {n: (c, float(v)) for n, c, v in zip(h.components, h.columns, values, strict=True)}
        values = {}
        for table, member in h.members:
            given = self.block.object_points if table == FIXED else self.block.groups[table - 1].values
            given = np.asarray(given)[member]
            for component, column in self.at[table, member].items():
                values["XYZ"[component]] = column, float(given[component])
        return values

    def _mistake(self, wrong: tuple[Hypothesis, ...], cause: Cause, parts: list[tuple[int, float]]) -> None:
        """Adds one column: the differences to the exchanged values."""
        up = -1.0 if wrong[0].subjects[0].table == "rays" and self._down(wrong[0]) else 1.0
        sign = {h.columns[1]: up for h in wrong if len(h.columns) > 1}
        combined: dict[int, float] = {}
        for column, value in parts:
            combined |= self._parts(column, sign.get(column, 1.0) * value)
        if not any(combined.values()):
            return
        subjects = tuple(h.subjects[0] for h in wrong)
        members = frozenset[tuple[int, int]]().union(*(h.members for h in wrong))
        column = self._combined(combined)
        self.found.append(Hypothesis(subjects, cause, (column,), ("",), ("",), members, False))

    def _down(self, h: Hypothesis) -> bool:
        """Whether y of the user's image coordinates points down."""
        return self.s.cameras[self.s.image_camera[self.s.image_names.index(h.subjects[0].names[0])]].image_unit == "px"


def _is_control(group: ObservationGroup) -> bool:
    kind = group.structure.kind
    return kind.in_object_system and kind.touches == ("point",)


def _sharing(block: Block, group: ObservationGroup) -> list[tuple[str, list[int]]]:
    """Rows of a navigation table by their common parameters: the name of the group, "" without one."""
    structure = group.structure
    shared = structure.indices[:, 1:]
    sets = []
    for own in np.unique(shared, axis=0) if shared.shape[1] else [np.zeros(0, int)]:
        rows = np.flatnonzero((shared == own).all(1) & structure.observed.any(1)).tolist()
        owner = block.structure.parameters[own[0]].owner if len(own) else None
        sets.append((owner.name if owner else "", rows))
    named = _alike_named(block, structure.indices[:, 0], np.any(structure.observed, axis=1))
    return [*sets, *named] if len(sets) == 1 else sets


def _alike_named(
    block: Block, images: Int[np.ndarray, " row"], observed: Bool[np.ndarray, " row"]
) -> list[tuple[str, list[int]]]:
    """Rows by the prefix before the last number of their image's name, such as strip "s1" of "s1_01", "s1_02"."""
    beginnings: dict[str, list[int]] = {}
    for row in np.flatnonzero(observed).tolist():
        name = block.structure.image_names[images[row]].rstrip("0123456789")
        beginnings.setdefault(name, []).append(row)
    if len(beginnings) < 2:
        return []
    return [(f"images {name}*", rows) for name, rows in beginnings.items() if name and len(rows) >= FEWEST_ALIKE]


def _largest(score: Float[np.ndarray, " row"], most: int) -> Int[np.ndarray, " chosen"]:
    """Rows of the largest positive scores, in the order of the table."""
    order = np.argsort(-score, kind="stable")[:most]
    return np.sort(order[score[order] > 0])
