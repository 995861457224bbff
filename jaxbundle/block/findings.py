"""Findings: what is wrong with a block or its adjustment, or should be looked at, as objects; words are made last.

    severity   what it means                                                     exit code of the command line
    FAILED     the result must not be used before this is cured                  1
    CHECK      the result stands, a person should look at this                   0
    NOTE       what was done or left out, or is good to know                     0

`Kind` is the table of verdicts: it lists everything that can be found, and how severe each is. One thing that is
found is one `Finding`, whatever the number of rows it concerns; its subjects are the culprits, the worst first.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple


class Severity(IntEnum):
    """How much a finding matters, the gravest first."""

    FAILED = 0
    CHECK = 1
    NOTE = 2

    @property
    def label(self) -> str:
        """The word in front of a finding in a report."""
        return ("failed", "check", "note")[self]


class Kind(Enum):
    """Everything that can be found, by name, with its severity. The order is that of a report: causes come first."""

    # before the adjustment, from the numbers given
    FORMAT = "rays and image format", Severity.FAILED
    INTERIOR = "implausible interior orientation", Severity.FAILED
    CONTROL_SYSTEM = "control and approximate values in different systems", Severity.FAILED
    NOT_USED = "control or stations given and not used", Severity.FAILED
    PARTS = "block in several parts", Severity.FAILED
    LOOSE = "images without orientation", Severity.FAILED
    ASSUMED = "assumption of the start", Severity.CHECK
    START = "implausible approximate values", Severity.CHECK
    REPAIRED = "approximate values replaced", Severity.NOTE
    APPROXIMATED = "approximate values found", Severity.NOTE
    # who causes it
    SYSTEMATIC = "group that disagrees as a whole", Severity.CHECK
    SUSPECT = "suspect observation", Severity.CHECK
    # how the adjustment ended
    NOT_CONVERGED = "not converged", Severity.FAILED
    BEHIND = "points behind cameras", Severity.FAILED
    MIRRORED = "mirrored solution", Severity.FAILED
    BELOW_TERRAIN = "stations below the terrain", Severity.FAILED
    UNDETERMINED = "undetermined unknowns", Severity.FAILED
    SIGMA0 = "residuals far beyond their sigmas", Severity.FAILED
    IMPRECISE = "unusable precision", Severity.FAILED
    # what the residuals tell
    DOWN_WEIGHTED = "small robust weights", Severity.CHECK
    UNSETTLED = "robust weights not settled", Severity.CHECK
    GLOBAL_TEST = "sigma0 outside its limits", Severity.CHECK
    SIGMAS = "sigmas of a group", Severity.CHECK
    CHECK_POINTS = "check points", Severity.CHECK
    # what the precision and the reliability tell
    WEAK = "weakly determined unknowns", Severity.CHECK
    CORRELATED = "correlated unknowns", Severity.CHECK
    INSIGNIFICANT = "insignificant elements", Severity.CHECK
    UNCONTROLLED = "uncontrolled observations", Severity.CHECK
    REDUNDANCY = "small redundancy", Severity.CHECK
    TWO_RAYS = "points on two images", Severity.CHECK
    # what takes no part
    NO_PRECISION = "no standard deviations", Severity.NOTE
    UNUSED = "rows that take no part", Severity.NOTE
    INFORMATION = "information", Severity.NOTE

    @property
    def title(self) -> str:
        """What it is about."""
        return self.value[0]

    @property
    def severity(self) -> Severity:
        """How severe it is unless the finding itself says otherwise."""
        return self.value[1]

    @property
    def rank(self) -> int:
        """Place in the order of a report; single culprits and groups stand in the order of their evidence."""
        return list(Kind).index(Kind.SUSPECT if self is Kind.SYSTEMATIC else self)


class Subject(NamedTuple):
    """What a finding is about: a table of the block folder, the names of a row and, if one is meant, a component.

    ("rays", ("8811", "333")) is image and point; ("control", ("422",), "Z"); ("cameras", ("scan",), "x0").
    """

    table: str
    names: tuple[str, ...] = ()
    component: str = ""


@dataclass(frozen=True)
class Finding:
    """One thing that is found.

    `what` is a sentence without a full stop: what is wrong, where, how much with its unit. `cure`: what to do, "" where
    there is nothing to do. `size` and `unit`: the number behind it, as the size of an error. `severity`: that of the
    kind if it is not given.
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
        """How severe it is."""
        return self.kind.severity if self.grade is None else self.grade

    @property
    def words(self) -> str:
        """What is wrong and the cure, one line."""
        return f"{self.what}; {self.cure}" if self.cure else self.what


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings as they are reported: by severity, then causes before consequences; each sentence once."""
    distinct = dict.fromkeys(findings)
    return tuple(sorted(distinct, key=lambda finding: (finding.severity, finding.kind.rank)))


def of_kind(findings: Iterable[Finding], *kinds: Kind) -> tuple[Finding, ...]:
    """Those of some kinds."""
    return tuple(finding for finding in findings if finding.kind in kinds)
