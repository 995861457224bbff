"""Unknown names that differ from known ones by a prefix, an extension, a leading zero, blanks, case or a slip."""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from jaxbundle.block.problems import shown

EXTENSION = re.compile(r"\.[A-Za-z][A-Za-z0-9]{1,3}$")
DECIMALS = re.compile(r"\.0+$")
LEAST = 0.2  # minimum share of the unknown names that must match: fewer match by chance
SHORTEST = 3  # minimum number of characters of a name in which one may be wrong


class Match(NamedTuple):
    """Matches of unknown names. `pairs`: unknown and known name; `words`: the change, such as "without '.tif'"."""

    pairs: dict[str, str]
    words: str
    of: int  # number of unknown names

    def __str__(self) -> str:
        """The matches in one sentence, such as "all 16 names match without 'GCP', such as 317 for GCP317"."""
        (unknown, known), *_ = self.pairs.items()
        found = len(self.pairs)
        how = f" {self.words}" if self.words else ""
        many = f"all {found} names match{how}" if found == self.of else f"{found} of {self.of} names match{how}"
        if self.of == 1:
            return f"did you mean {shown(known)} for {shown(unknown)}{f' ({self.words})' if how else ''}?"
        return f"{many}: did you mean {shown(known)} for {shown(unknown)}{' and so on' if found > 1 else ''}?"


def _without(pattern: re.Pattern[str]) -> Callable[[str], str]:
    return lambda name: pattern.sub("", name)


def _folded(name: str) -> str:
    return "".join(name.split()).casefold()


def _stem(name: str) -> str:
    return re.split(r"[/\\]", name)[-1]


SIMPLE: tuple[tuple[str, Callable[[str], str]], ...] = (
    ("except for upper and lower case or blanks", _folded),
    ("without the decimal '.0'", _without(DECIMALS)),
    ("without leading zeros", lambda name: name.lstrip("0") or "0"),
    ("without the folder", _stem),
    ("without the extension", lambda name: EXTENSION.sub("", _stem(name))),
    ("except for '-', '_', '.' or blanks", lambda name: re.sub(r"[-_.\s]", "", name).casefold()),
)


def nearest(unknown: Iterable[str], known: Sequence[str]) -> Match | None:
    """The change that makes the maximum number of unknown names known; None where it makes none known.

    A change that makes two known names equal matches neither of them.
    """
    wanted = [name for name in dict.fromkeys(unknown) if name]
    if not wanted or not known:
        return None
    changes = [*SIMPLE, *_prefixes(wanted, known)]
    matches = [Match(_pairs(wanted, known, change), _exact(words, wanted), len(wanted)) for words, change in changes]
    best = max(matches, key=lambda match: len(match.pairs))
    return best if len(best.pairs) > LEAST * len(wanted) else None


def _exact(words: str, names: Sequence[str]) -> str:
    """Puts the extension itself into the words, where all names have the same extension."""
    found = {match[0] if (match := EXTENSION.search(name)) else "" for name in names}
    return (
        f"without '{shown(found.pop())}'"
        if words.endswith("extension") and len(found) == 1 and "" not in found
        else words
    )


def _pairs(wanted: Sequence[str], known: Sequence[str], change: Callable[[str], str]) -> dict[str, str]:
    changed: dict[str, str] = {}
    doubtful = set()
    for name in known:
        key = change(name)
        if changed.setdefault(key, name) != name:
            doubtful.add(key)
    keys = {name: change(name) for name in wanted}
    return {name: changed[key] for name, key in keys.items() if key and key in changed and key not in doubtful}


def _prefixes(wanted: Sequence[str], known: Sequence[str]) -> list[tuple[str, Callable[[str], str]]]:
    """Changes that remove the common prefix of all unknown or all known names, up to the first digit, or whole."""
    found = []
    for names, of in ((wanted, ""), (known, " of the known names")):
        common = os.path.commonprefix(names) if len(names) > 1 else names[0]
        letters = re.match(r"\D*", common)
        for prefix in dict.fromkeys((letters[0] if letters else "", common)):
            if prefix and (len(names) > 1 or prefix != names[0]):
                found.append((f"without '{shown(prefix)}'{of}", lambda name, prefix=prefix: name.removeprefix(prefix)))
    return found


def slip(name: str, known: Iterable[str]) -> str:
    """Finds the only known name that differs by one slip; "" where there is none or more than one.

    An exchange of two neighbouring characters counts before one wrong, missing or additional character.
    """
    if len(name) < SHORTEST:
        return ""
    exchanged, replaced = [], []
    for other in known:
        if abs(len(other) - len(name)) > 1 or other == name:
            continue
        kind = _slip(name, other)
        if kind:
            (exchanged if kind == 2 else replaced).append(other)
    best = exchanged or replaced
    return best[0] if len(best) == 1 else ""


def _slip(a: str, b: str) -> int:
    """2: two neighbouring characters are exchanged; 1: one character differs, is missing or additional; 0: neither."""
    same = len(os.path.commonprefix((a, b)))
    rest_a, rest_b = a[same:], b[same:]
    if len(a) == len(b):
        if len(rest_a) > 1 and rest_a[0] == rest_b[1] and rest_a[1] == rest_b[0] and rest_a[2:] == rest_b[2:]:
            return 2
        return int(rest_a[1:] == rest_b[1:])
    longer, shorter = (rest_a, rest_b) if len(a) > len(b) else (rest_b, rest_a)
    return int(longer[1:] == shorter)
