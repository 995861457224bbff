"""Findings about a block or its adjustment (problems, suggestions, notes) as objects; words are made last.

    severity   what it means                                                     exit code of the command line
    FAILED     the result must not be used before this is cured                  1
    CHECK      the result is valid, but a person should check this               0
    NOTE       actions of the program, or useful information                     0

`Kind` lists all kinds of findings with their severity. One problem is one `Finding`, independent of the number of
rows; its subjects are the rows that cause it, the worst first.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple


class Severity(IntEnum):
    """Severity of a finding, the most severe first.

    Example:
        >>> min(jb.blocks.Severity).label
        'failed'
    """

    FAILED = 0
    CHECK = 1
    NOTE = 2

    @property
    def label(self) -> str:
        """The word before a finding in a report."""
        return ("failed", "check", "note")[self]


class Kind(Enum):
    """All kinds of findings, with words and severity. The order is that of a report: causes come first.

    Example:
        >>> jb.blocks.Kind.SIGMAS.title, jb.blocks.Kind.SIGMAS.severity.label
        ('sigmas of a group', 'check')
    """

    # before the adjustment, from the input values
    FORMAT = "rays and image format", Severity.FAILED
    INTERIOR = "implausible interior orientation", Severity.FAILED
    CONTROL_SYSTEM = "control and approximate values in different systems", Severity.FAILED
    NOT_USED = "control or stations not used", Severity.FAILED
    PARTS = "block in several parts", Severity.FAILED
    LOOSE = "images without orientation", Severity.FAILED
    ASSUMED = "assumption of the start", Severity.CHECK
    START = "implausible approximate values", Severity.CHECK
    REPAIRED = "approximate values replaced", Severity.NOTE
    APPROXIMATED = "approximate values computed", Severity.NOTE
    # causes
    SYSTEMATIC = "group that disagrees as a whole", Severity.CHECK
    SUSPECT = "suspect observation", Severity.CHECK
    # end of the adjustment
    NOT_CONVERGED = "not converged", Severity.FAILED
    BEHIND = "points behind cameras", Severity.FAILED
    MIRRORED = "mirrored solution", Severity.FAILED
    BELOW_TERRAIN = "stations below the terrain", Severity.FAILED
    UNDETERMINED = "undetermined unknowns", Severity.FAILED
    SIGMA0 = "residuals far beyond their sigmas", Severity.FAILED
    IMPRECISE = "unusable precision", Severity.FAILED
    # from the residuals
    DOWN_WEIGHTED = "small robust weights", Severity.CHECK
    UNSETTLED = "robust weights not converged", Severity.CHECK
    GLOBAL_TEST = "sigma0 outside its limits", Severity.CHECK
    SIGMAS = "sigmas of a group", Severity.CHECK
    CHECK_POINTS = "check points", Severity.CHECK
    # from precision and reliability
    WEAK = "weakly determined unknowns", Severity.CHECK
    CORRELATED = "correlated unknowns", Severity.CHECK
    INSIGNIFICANT = "insignificant elements", Severity.CHECK
    UNCONTROLLED = "uncontrolled observations", Severity.CHECK
    REDUNDANCY = "small redundancy", Severity.CHECK
    TWO_RAYS = "points on two images", Severity.CHECK
    # unused data
    NO_PRECISION = "no standard deviations", Severity.NOTE
    UNUSED = "rows that are not used", Severity.NOTE
    INFORMATION = "information", Severity.NOTE

    @property
    def title(self) -> str:
        """The kind in words."""
        return self.value[0]

    @property
    def severity(self) -> Severity:
        """Default severity of findings of this kind."""
        return self.value[1]

    @property
    def rank(self) -> int:
        """Position in the order of a report; suspect groups and observations are in the order of their evidence."""
        return list(Kind).index(Kind.SUSPECT if self is Kind.SYSTEMATIC else self)


class Subject(NamedTuple):
    """Subject of a finding: a table of the block folder, the names of a row and, for one component, its name.

    ("rays", ("8811", "333")) is image and point; ("control", ("422",), "Z"); ("cameras", ("scan",), "x0").

    Example:
        >>> jb.blocks.Subject("control", ("A",), "Z")
        Subject(table='control', names=('A',), component='Z')
    """

    table: str
    names: tuple[str, ...] = ()
    component: str = ""


@dataclass(frozen=True)
class Finding:
    """One finding about a block or an adjustment.

    `what` is a sentence without a full stop: what is wrong, where, and how much with its unit. `cure`: what to do, ""
    if nothing. `size` and `unit`: the main number, such as the size of an error. `severity`: that of the kind by
    default.

    Example:
        >>> what = "sigma of point A is 0.001 m"
        >>> finding = jb.blocks.Finding(jb.blocks.Kind.SIGMAS, what, "check it", size=0.001, unit="m")
        >>> finding.severity.name, finding.cure
        ('CHECK', 'check it')
    """

    kind: Kind
    what: str
    cure: str = ""
    subjects: tuple[Subject, ...] = ()
    size: float = math.nan
    unit: str = ""
    grade: Severity | None = None

    @property
    def severity(self) -> Severity:
        """The severity of this finding."""
        return self.kind.severity if self.grade is None else self.grade

    @property
    def words(self) -> str:
        """Problem and cure in one line."""
        return f"{self.what}; {self.cure}" if self.cure else self.what


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings in the order of a report: by severity, causes before consequences; each sentence once."""
    distinct = dict.fromkeys(findings)
    return tuple(sorted(distinct, key=lambda finding: (finding.severity, finding.kind.rank)))


def of_kind(findings: Iterable[Finding], *kinds: Kind) -> tuple[Finding, ...]:
    """The findings of some kinds."""
    return tuple(finding for finding in findings if finding.kind in kinds)
