"""Tables that are generated from the package when the site is built.

    <!-- table: job keys -->      every key of a job: type, unit, default, meaning
    <!-- table: columns NAME -->  every column of a Parquet table: unit, description
    <!-- table: json NAME -->     every value in docs/schemas/NAME-1.json: type, meaning
    <!-- table: statuses NAME --> every member of an enumeration in htcp_jax.status: name, meaning

Types and ranges of job keys come from the schema of `PlanConfig`, their meanings from the comments in
configs/duct.yaml.
"""

import json
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from htcp_jax import status
from htcp_jax.jobs import PlanConfig
from htcp_jax.runs import columns

MARK = re.compile(r"^<!-- table: (job keys|columns|json|statuses)(?: (\w+))? -->$", re.MULTILINE)
JOB = Path(__file__).parents[2] / "configs" / "duct.yaml"
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
    """Replace the marks by tables; called by mkdocs with every page's source."""
    tables = {"columns": columns_table, "json": json_table, "statuses": statuses_table}
    return MARK.sub(lambda found: tables[found[1]](found[2]) if found[2] else keys_table(), markdown)


def keys_table() -> str:
    """Return the table of all job keys."""
    heads = "| key | type | unit | default | meaning |\n|---|---|---|---|---|\n"
    rows = (f"| `{k.name}` | {k.kind} | {k.unit} | `{k.default}` | {_cell(k.meaning)} |" for k in job_keys())
    return heads + "\n".join(rows)


def columns_table(table: str) -> str:
    """Return the table of the columns of a Parquet table."""
    texts = columns.TABLES[table].items()
    rows = (f"| `{name}` | {columns.unit_of(name, ())} | {_cell(text)} |" for name, text in texts)
    return "| column | unit | description |\n|---|---|---|\n" + "\n".join(rows)


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
        found.append(JobKey(name, _words(kind, schema), unit, shown, meaning))
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
