"""Navigation data in tables: `group` and `time` of stations.csv and attitudes.csv, and the sections [navigation.NAME].

    stations.csv     image,X,Y,Z,sX,sY,sZ,group,time                   group, time: may be absent
    attitudes.csv    image, three angles, their sigmas (somega, ...), group, time

Times count from the mean of their group: shift and drift are those at that time.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxbundle.block.problems import shown
from jaxbundle.io.block_toml import FILE, BlockToml
from jaxbundle.io.ranges import LARGEST_TIME
from jaxbundle.io.settings import OF_ATTITUDES, OF_STATIONS, NavigationSection
from jaxbundle.io.tables import Table

KINDS = {"stations": OF_STATIONS, "attitudes": OF_ATTITUDES}
DRIFTS = ("drift", "attitude_drift")
CENTRED = 1e-9  # of the span of the times: a mean below it is 0 but for rounding


@dataclass(frozen=True)
class NavigationRows:
    """The group of each row, -1 where it has none, and its time from the mean of the group; 0 where not given."""

    table: Table
    group: Int[np.ndarray, " row"]
    time: Float[np.ndarray, " row"]


@dataclass(frozen=True)
class Navigation:
    """Rows of both tables, as far as they are given; `origin` is the mean time of each group."""

    rows: dict[str, NavigationRows]
    names: tuple[str, ...]
    origin: Float[np.ndarray, " group"]

    def groups_of(self, kind: str) -> Int[np.ndarray, " group"]:
        """Numbers of the groups that a table names."""
        if kind not in self.rows:
            return np.zeros(0, int)
        groups = self.rows[kind].group
        return np.unique(groups[groups >= 0])


def navigation(tables: Mapping[str, Table], toml: BlockToml) -> Navigation:
    """Groups and times of stations and attitudes."""
    names = toml.navigation_names
    given = {kind: tables[kind] for kind in KINDS if kind in tables}
    group = {kind: _groups(table, names) for kind, table in given.items()}
    times = {kind: table.numbers("time", largest=LARGEST_TIME)[:, 0] for kind, table in given.items()}
    origin = np.zeros(len(names))
    for k in range(len(names)):
        together = np.concatenate([np.zeros(0), *(times[kind][group[kind] == k] for kind in given)])
        together = together[np.isfinite(together)]
        if len(together) and abs(together.mean()) > CENTRED * np.ptp(together):
            origin[k] = together.mean()
    rows = {}
    for kind, table in given.items():
        _require_times(kind, table, group[kind], times[kind], toml)
        start = np.where(group[kind] >= 0, np.append(origin, 0.0)[group[kind]], 0.0)
        rows[kind] = NavigationRows(table, group[kind], np.nan_to_num(times[kind] - start))
    return Navigation(rows, names, origin)


def _groups(table: Table, names: tuple[str, ...]) -> Int[np.ndarray, " row"]:
    """The number of each row's group; a name that block.toml does not have is noted."""
    wanted = table.column("group").to_list()
    number = {name: k for k, name in enumerate(names)}
    unknown: dict[str, list[int]] = {}
    for row, name in enumerate(wanted):
        if name and name not in number:
            unknown.setdefault(name, []).append(row)
    for name, rows in unknown.items():
        cure = f"add [navigation.{shown(name)}] there, correct the name or leave it empty"
        table.note(rows, f"group {shown(name)} is not in {FILE}", cure)
    return np.array([number.get(name, -1) for name in wanted], int)


def _require_times(
    kind: str, table: Table, group: Int[np.ndarray, " row"], times: Float[np.ndarray, " row"], toml: BlockToml
) -> None:
    """Notes a group with a drift whose times are not known or all the same."""
    sections = toml.settings.navigation if toml.settings else None
    drift = next(name for name in KINDS[kind] if name in DRIFTS)
    for k, (name, section) in enumerate((sections or {}).items()):
        if drift not in section.estimate and not any(getattr(section, drift) or ()):
            continue
        rows = np.flatnonzero(group == k)
        missing = rows[np.isnan(times[rows]) & (table.column("time").to_numpy()[rows] == "")]
        if len(missing):
            table.note(
                int(missing[0]), f"group {name} has a {drift} and the row no time", "give the time in a column time"
            )
        elif len(rows) and drift not in (section.priors or {}) and np.ptp(times[rows]) == 0:
            what = f"group {name} has a {drift} to estimate and all its times are the same"
            table.note(int(rows[0]), what, f"give its true times, a prior of the {drift}, or hold it")


def section_of(toml: BlockToml, name: str) -> NavigationSection:
    """The section of a group; where there is none, or it is wrong, one without systematic errors."""
    sections = toml.settings.navigation if toml.settings else None
    return (sections or {}).get(name) or NavigationSection()
