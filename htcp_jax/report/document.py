"""Document of headings, paragraphs, tables and pictures, with output as Markdown, HTML, CSV and mappings."""

import base64
import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple

from htcp_jax.markup import escaped
from htcp_jax.runs import Column, columns
from htcp_jax.system import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

PAGE = Path(__file__).with_name("page.html")
REM_PER_INCH = 6.8  # a figure of 10 inch is as wide as the page
LEAST_CONTENTS = 3  # number of headings from which on a page has a list of contents


class Table(NamedTuple):
    """Table with columns and rows of values; `name` is the stem of its CSV file."""

    name: str
    columns: tuple[Column, ...]
    rows: tuple[tuple, ...]
    title: str = ""

    @classmethod
    def of(cls, name: str, keys: Iterable[str | Column], rows: Iterable[Mapping[str, Any]], title: str = "") -> "Table":
        """Return the table with the columns of these keys, see `runs.columns`.

        Args:
            name: Name of the table.
            keys: Keys of columns, or columns.
            rows: Values by key; missing values are None, and values of other keys are omitted.
            title: Title of the table.
        """
        chosen = columns.of(*keys)
        return cls(name, chosen, tuple(tuple(row.get(column.key) for column in chosen) for row in rows), title)

    def part(self, chosen: Sequence[int]) -> "Table":
        """Return the table with the columns at these indices."""
        rows = tuple(tuple(row[k] for k in chosen) for row in self.rows)
        return self._replace(columns=tuple(self.columns[k] for k in chosen), rows=rows)

    def without_empty(self) -> "Table":
        """Return the table without its columns in which all values are None."""
        return self.part([k for k in range(len(self.columns)) if any(row[k] is not None for row in self.rows)])

    def records(self) -> list[dict]:
        """Return the rows as mappings of values by column key; unknown values are None."""
        keys = [column.key for column in self.columns]
        return [
            {key: None if columns.unknown(cell) else cell for key, cell in zip(keys, row, strict=True)}
            for row in self.rows
        ]


class Picture(NamedTuple):
    """Figure or image in a document; `name` is the stem of its file, `alt` its alternative text.

    With `half` it takes half of the page's width, next to another one; on a narrow screen all of it.
    """

    name: str
    figure: "Figure | Image"
    alt: str
    half: bool = False


class Heading(NamedTuple):
    """A heading of level 1 to 4."""

    level: int
    text: str


Block = Heading | Table | Picture | str  # a string is a paragraph


def markdown(blocks: Sequence[Block]) -> str:
    """Return the blocks as Markdown, with pictures as links to files in the same folder."""
    return "\n\n".join(map(_markdown, blocks)) + "\n"


def literal(block: Block) -> Block:
    """Return the block with its text escaped for Markdown, as `html` does for HTML.

    Cells of a table are escaped by `markdown`.
    """
    match block:
        case Heading(level, text):
            return Heading(level, escaped(text))
        case Table():
            return block._replace(title=escaped(block.title))
        case Picture():
            return block._replace(alt=escaped(block.alt.replace("[", "(").replace("]", ")")))  # no brackets in "alt"
    return escaped(block)


def html(blocks: Sequence[Block], pictures: dict[str, bytes]) -> str:
    """Return the blocks as one self-contained HTML file without scripts.

    Args:
        blocks: The blocks.
        pictures: Contents of the PNG files, by the pictures' names.
    """
    title = next((block.text for block in blocks if isinstance(block, Heading)), "Report")
    anchors = {k: f"section-{k}" for k, block in enumerate(blocks) if isinstance(block, Heading) and block.level > 1}
    parts = [_html(block, pictures, anchors.get(k, "")) for k, block in enumerate(blocks)]
    if len(anchors) >= LEAST_CONTENTS:  # before the first section, or after a table there
        first = next((k + 1 for k in range(min(anchors)) if isinstance(blocks[k], Table)), min(anchors))
        parts.insert(first, _contents({anchor: blocks[k] for k, anchor in anchors.items()}))
    return Template(PAGE.read_text()).substitute(title=escape(title), body="\n".join(parts))


def write_csv(file: Path, table: Table) -> None:
    """Write the table as CSV, with numbers in full precision; unknown values are empty cells."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.key for column in table.columns])
    for row in table.rows:
        writer.writerow(["" if columns.unknown(cell) else cell for cell in row])
    files.write_atomically(file.parent, file.name, stream.getvalue().encode())


def png(figure: "Figure | Image") -> bytes:
    """Return a figure or an image as the bytes of a PNG file."""
    stream = io.BytesIO()
    if hasattr(figure, "savefig"):
        figure.savefig(stream, format="png", metadata={"Software": None})
    else:
        figure.save(stream, format="png", optimize=True)
    return stream.getvalue()


def _markdown(block: Block) -> str:
    match block:
        case Heading(level, text):
            return f"{'#' * level} {text}"
        case Table():
            return _markdown_table(block)
        case Picture(name, _, alt, _):
            return f"![{alt}]({name}.png)"
    return block


def _markdown_table(table: Table) -> str:
    """Return the table in Markdown, with columns aligned in the source."""
    lines = [[column.title for column in table.columns], *_texts(table)]
    lines = [[escaped(cell) for cell in line] for line in lines]
    widths = [max(3, *map(len, cells)) for cells in zip(*lines, strict=True)]
    rule = ["-" * (w - 1) + ":" if c.format else "-" * w for c, w in zip(table.columns, widths, strict=True)]
    padded = [
        [t.rjust(w) if c.format else t.ljust(w) for t, c, w in zip(line, table.columns, widths, strict=True)]
        for line in lines
    ]
    text = "\n".join("| " + " | ".join(line) + " |" for line in (padded[0], rule, *padded[1:]))
    return f"**{table.title}**\n\n{text}" if table.title else text


def _contents(headings: Mapping[str, Any]) -> str:
    """Return the list of contents: links to the two highest levels of the headings, given by their anchors."""
    top = min(heading.level for heading in headings.values())
    links = [
        f'<li class="level{heading.level - top}"><a href="#{anchor}">{escape(heading.text)}</a></li>'
        for anchor, heading in headings.items()
        if heading.level < top + 2
    ]
    return f'<nav aria-label="Contents"><ul>\n{chr(10).join(links)}\n</ul></nav>'


def _html(block: Block, pictures: dict[str, bytes], anchor: str = "") -> str:
    match block:
        case Heading(level, text):
            return f"<h{level}{f' id={chr(34)}{anchor}{chr(34)}' * bool(anchor)}>{escape(text)}</h{level}>"
        case Table():
            return _html_table(block)
        case Picture(name, figure, alt, half):
            data, kind = base64.b64encode(pictures[name]).decode(), "half" if half else "picture"
            widest = (
                f' style="max-width: {REM_PER_INCH * figure.get_figwidth():.0f}rem"'
                if hasattr(figure, "savefig")
                else ""
            )
            return f'<div class="{kind}"><img src="data:image/png;base64,{data}" alt="{escape(alt)}"{widest}></div>'
    return f"<p>{escape(block)}</p>"


def _html_table(table: Table) -> str:
    kinds = [" ".join(("number" if c.format else "", "quiet" if c.quiet else "")).strip() for c in table.columns]
    has_units = any(c.unit for c in table.columns)
    below = [f"<br><small>{escape(c.unit) or '&nbsp;'}</small>" if has_units else "" for c in table.columns]
    heads = [
        f'<th class="{kind}">{escape(c.heading)}{unit}</th>'
        for c, kind, unit in zip(table.columns, kinds, below, strict=True)
    ]
    rows = [
        "".join(f'<td class="{kind}">{escape(text)}</td>' for text, kind in zip(line, kinds, strict=True))
        for line in _texts(table)
    ]
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    head = f"<thead><tr>{''.join(heads)}</tr></thead>"
    return f'<div class="wide" tabindex="0"><table>{caption}{head}<tbody>\n{body}\n</tbody></table></div>'


def _texts(table: Table) -> list[list[str]]:
    return [[c.text(value) for c, value in zip(table.columns, row, strict=True)] for row in table.rows]
