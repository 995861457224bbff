"""Elements of HTML and SVG as text; every name and sentence of a user is escaped on its way in."""

import html
from collections.abc import Iterable

VOID = ("br", "line", "circle", "rect", "path", "polygon", "polyline", "image", "input", "meta")


def text(words: object) -> str:
    """Words as they may stand between tags and in attributes."""
    return html.escape(str(words), quote=True)


def tag(name: str, inside: str | Iterable[str] = "", **attributes: object) -> str:
    """An element. `inside` is markup already; attributes are escaped: `class_`, `data_name` stand for class, data-name;
    one that is None is left out, and numbers have two decimals at most."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(_short(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    body = inside if isinstance(inside, str) else "".join(inside)
    if name in VOID:
        return f"<{name}{written}/>" if not body else f"<{name}{written}>{body}</{name}>"
    return f"<{name}{written}>{body}</{name}>"


def _short(value: object) -> object:
    return f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else value


def titled(words: str) -> str:
    """What a mark says when it is pointed at."""
    return f"<title>{text(words)}</title>"


def figure(picture: str, caption: str, kind: str = "") -> str:
    """A picture and what it shows; the caption is words, not markup."""
    return tag("figure", picture + tag("figcaption", text(caption)), class_=kind or None)
