"""Elements of HTML and SVG as text; all names and sentences from the user are escaped."""

import html
from collections.abc import Iterable

VOID = ("br", "line", "circle", "rect", "path", "polygon", "polyline", "image", "input", "meta")


def text(words: object) -> str:
    """Text escaped for use between tags and in attributes."""
    return html.escape(str(words), quote=True)


def tag(name: str, inside: str | Iterable[str] = "", **attributes: object) -> str:
    """An element as text.

    `inside` is markup; attributes are escaped: `class_`, `data_name` become class, data-name. Attributes that are None
    are left out, and numbers have at most two decimals.
    """
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
    """The tooltip of a mark."""
    return f"<title>{text(words)}</title>"


def figure(picture: str, caption: str, kind: str = "") -> str:
    """A picture with its caption; the caption is text, not markup."""
    return tag("figure", picture + tag("figcaption", text(caption)), class_=kind or None)
