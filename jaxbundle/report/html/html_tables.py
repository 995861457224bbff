"""Facts and tables of the sections in HTML; each row has an id for the links of findings."""

from collections.abc import Mapping

from jaxbundle.report.html.markup import tag, text
from jaxbundle.report.section import Facts, ReportColumn, ReportTable, Section

# maximum number of rows of a table, so that the page is below 3 MB; the files contain all
ROWS = {"images": 1500, "points": 500, "rays": 300}
OTHER_ROWS = 500
SEARCHED = 12  # number of rows above which a table has a search field
PLAIN = 25  # maximum number of rows of a table in full height

Rows = dict[tuple[str, tuple[str, ...]], str]  # ids of rows by table and names


def section_html(section: Section, extra: Mapping[str, tuple[ReportColumn, ...]], rows: Rows) -> str:
    """A section with its heading; empty where it has no parts. `extra`: additional columns of a table in the page."""
    body = []
    for part in section.parts:
        if isinstance(part, Facts):
            body.append(facts_html(part))
        elif isinstance(part, ReportTable):
            body.append(table_html(part, extra.get(part.name, ()), rows))
        elif part:
            body.append(tag("p", text(part)))
    inside = "".join(body)
    return tag("section", tag("h3", text(section.title)) + inside, class_="part") if inside else ""


def facts_html(facts: Facts) -> str:
    """Markup of facts in a column."""
    pairs = [tag("dt", text(one.label)) + tag("dd", text(one.text)) for one in facts.facts if one.text]
    return tag("dl", pairs) if pairs else ""


def table_html(table: ReportTable, extra: tuple[ReportColumn, ...], rows: Rows) -> str:
    """The first rows of a table, and the number of all; empty where it has no rows."""
    every = table.page if table.rows is None else table.rows
    shown = every[: ROWS.get(table.name, OTHER_ROWS)].tolist()
    if not shown:
        return ""
    columns = sorted((c for c in table.columns if c.head is not None), key=lambda column: column.place)
    columns += extra
    names = [column for column in columns if column.is_name]
    head = tag("tr", [tag("th", tag("button", text(c.head), type="button"), scope="col") for c in columns])
    lines = []
    for row in shown:
        key = (table.name, tuple(str(column.values[row]) for column in names))
        rows.setdefault(key, f"{table.name}-{row}")
        cells = [_cell(column, row) for column in columns]
        lines.append(tag("tr", cells, id=f"{table.name}-{row}"))
    whole = tag("table", tag("thead", head) + tag("tbody", lines), class_="sortable", data_table=table.name)
    search = ""
    if len(shown) > SEARCHED:
        label = f"search in {table.name.replace('_', ' ')}"
        search = tag("input", type="search", placeholder="search", aria_label=label, class_="search scripted")
    total = len(table.columns[0].values) if table.in_file else len(every)
    said = tag("p", text(_where(table, len(shown), total)), class_="more") if len(shown) < total else ""
    kind = "table tall" if len(shown) > PLAIN else "table"
    return search + tag("div", whole, class_=kind, tabindex="0") + said


def _where(table: ReportTable, shown: int, every: int) -> str:
    file = f"{table.name}.csv" if table.in_file else "report.json"
    return f"{shown} of {every} rows are shown; {file} has all of them."


def _cell(column: ReportColumn, row: int) -> str:
    value = column.values[row]
    if column.is_name:
        shown = column.show(value)
        return tag("th", text(shown), scope="row", title=value if shown != value else None)
    return f"<td>{text(column.show(value))}</td>"  # of many thousand cells: quicker than `tag`
