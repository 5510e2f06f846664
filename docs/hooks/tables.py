"""Parts of pages that are generated from the package. `python docs/hooks/tables.py` writes them; a test checks them.

    <!-- generated: job keys -->      every key of a job: type, unit, default, meaning
    <!-- generated: columns NAME -->  every column of a Parquet table: unit, description
    <!-- generated: json NAME -->     every value in docs/schemas/NAME-1.json: type, meaning
    <!-- generated: statuses NAME --> every member of an enumeration in htcp_jax.status: name, meaning
    <!-- generated: file PATH -->     a file of the repository

Each part ends with END. Types and ranges of job keys come from the schema of `PlanConfig`, their meanings from the
comments in configs/duct.yaml. NOTE, which explains on a code host why a page looks empty, is removed from the site.
"""

import json
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from htcp_jax import status
from htcp_jax.runs import columns
from htcp_jax.spec import PlanConfig

END = "<!-- end of the generated part -->"
MARK = re.compile(
    rf"^(<!-- generated: (job keys|columns|json|statuses|file)(?: ([\w./]+))? -->)\n(?:.*?^{END}$)?",
    re.MULTILINE | re.DOTALL,
)
NOTE = (
    "*`make docs` builds this page with all descriptions into `build/site`. In Python `help` prints the same text.*\n"
)
ROOT = Path(__file__).parents[2]
JOB = ROOT / "configs" / "duct.yaml"
SCHEMAS = Path(__file__).parents[1] / "schemas"
UNITS = {"_rad": "rad", "_m": "m", "_s": "s", "num_cpus": "cores"}
LIMITS = {"minimum": ">= {:g}", "exclusiveMinimum": "> {:g}", "maximum": "<= {:g}", "exclusiveMaximum": "< {:g}"}
WIDE = 1e5  # bounds beyond are against mistyped numbers only


class JobKey(NamedTuple):
    """One key of a job file."""

    name: str  # dotted
    kind: str
    unit: str
    default: str
    meaning: str


def on_page_markdown(markdown: str, **_) -> str:
    """Remove NOTE; called by mkdocs with every page's source."""
    return markdown.replace(NOTE, "")


def filled(markdown: str) -> str:
    """Return a page with all its generated parts made anew."""
    parts = {"columns": columns_table, "json": json_table, "statuses": statuses_table, "file": shown_file}

    def part(found: re.Match) -> str:
        mark, kind, name = found.groups()
        return f"{mark}\n\n{parts[kind](name) if name else keys_table()}\n\n{END}"

    return MARK.sub(part, markdown)


def shown_file(name: str) -> str:
    """Return a file of the repository as a block of code."""
    file = ROOT / name
    return f"```{file.suffix[1:]}\n{file.read_text().rstrip()}\n```"


def keys_table() -> str:
    """Return the table of all job keys."""
    heads = "| key | type | unit | default | meaning |\n|---|---|---|---|---|\n"
    rows = (f"| `{k.name}` | {k.kind} | {k.unit} | `{k.default}` | {_cell(k.meaning)} |" for k in job_keys())
    return heads + "\n".join(rows)


def columns_table(table: str) -> str:
    """Return the table of the columns of a Parquet table."""
    texts, needed = columns.TABLES[table].items(), columns.NEEDED[table]
    rows = (
        f"| `{name}` | {columns.unit_of(name, ())} | {needed.get(name, '')} | {_cell(text)} |" for name, text in texts
    )
    return "| column | unit | has a value | description |\n|---|---|---|---|\n" + "\n".join(rows)


def json_table(name: str) -> str:
    """Return the table of the values that a JSON schema lists, those of an array's items under `[]`."""
    rows = (f"| `{where}` | {kind} | {_cell(text)} |" for where, kind, text in _values(_schema(name), ""))
    return "| value | type | meaning |\n|---|---|---|\n" + "\n".join(rows)


def _schema(name: str) -> dict[str, Any]:
    return json.loads((SCHEMAS / f"{name}-1.json").read_text())


def _values(schema: dict[str, Any], where: str) -> Iterator[tuple[str, str, str]]:
    """Yield the place, type and meaning of every value below."""
    for key, each in schema.get("properties", {}).items():
        kinds = each["type"] if isinstance(each["type"], list) else [each["type"]]
        yield f"{where}{key}", " or ".join(kinds), each.get("description", "")
        yield from _values(each, f"{where}{key}.")
    if isinstance(more := schema.get("additionalProperties"), dict):
        yield from _values(more, f"{where}NAME.")
    if "items" in schema:
        yield from _values(schema["items"], f"{where[:-1]}[].")


def statuses_table(enumeration: str) -> str:
    """Return the table of the members of an enumeration in `htcp_jax.status`."""
    rows = (f"| `{each.name}` | {_cell(each.message)} |" for each in getattr(status, enumeration))
    return "| name | meaning |\n|---|---|\n" + "\n".join(rows)


def job_keys() -> list[JobKey]:
    """Return all keys in the order of the default job."""
    schema, default, found = PlanConfig.model_json_schema(), yaml.safe_load(JOB.read_text()), []
    for name, meaning in meanings(JOB.read_text()).items():
        kind, value = schema, default
        for part in name.split("."):
            kind, value = _resolved(kind, schema)["properties"][part], value[part]
        unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
        shown = yaml.safe_dump(value, default_flow_style=True).split("\n")[0]
        found.append(JobKey(name, "mapping" if value == {} else _words(kind, schema), unit, shown, meaning))
    return found


def meanings(text: str) -> dict[str, str]:
    """Return the comments at the keys of a job file, sections left out, by dotted key."""
    found: dict[str, str] = {}
    section, last = "", ""
    for line in text.splitlines():
        key = re.match(r"( *)(\w+):([^#]*)(?:# ?(.*))?$", line)
        if key is None:
            more = re.match(r" *# ?(.*)", line)
            if more and last and found.get(last):
                found[last] += f" {more[1]}"
            last = last if more else ""
            continue
        indent, name, value, comment = key.groups()
        if not indent and not value.strip():
            section, last = f"{name}.", ""
            continue
        last = (section if indent else "") + name
        found[last] = comment or ""
    return {name: re.sub("[,;]$", "", words.strip()) for name, words in found.items()}


def _cell(text: str) -> str:
    """Return text as a cell of a table."""
    if text.endswith("}"):
        text = text.replace("{", r"\{")  # else attr_list takes the braces for attributes of the cell
    return escape(text, quote=False).replace("|", r"\|")


def _resolved(kind: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    return schema["$defs"][kind["$ref"].rpartition("/")[2]] if "$ref" in kind else kind


def _words(kind: dict[str, Any], schema: dict[str, Any]) -> str:
    """Return a type of the schema in words."""
    kind = _resolved(kind, schema)
    if "anyOf" in kind:
        return " or ".join(dict.fromkeys(_words(each, schema) for each in kind["anyOf"]))
    if "enum" in kind:
        return ", ".join(map(str, kind["enum"]))
    if "const" in kind:
        return str(kind["const"])
    if kind.get("type") == "array":
        items = kind.get("prefixItems")
        return f"{len(items)} numbers" if items else "list"
    names = {"number": "number", "integer": "whole number", "boolean": "true, false", "string": "text", "null": "null"}
    bounds = [form.format(kind[name]) for name, form in LIMITS.items() if name in kind and abs(kind[name]) < WIDE]
    return " ".join(filter(None, (names.get(kind.get("type", ""), "mapping"), " and ".join(bounds))))


if __name__ == "__main__":
    for page in sorted((ROOT / "docs").rglob("*.md")):
        if (made := filled(text := page.read_text())) != text:
            page.write_text(made)
