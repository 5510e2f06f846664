"""How an object shows itself in a notebook: a title and a short table of facts."""

from collections.abc import Mapping
from html import escape


def html_facts(title: str, facts: Mapping[str, str]) -> str:
    """The facts as an HTML table, a row a fact."""
    cell = '<td style="text-align: left; vertical-align: top">{}</td>'
    rows = "".join(f"<tr>{cell.format(escape(name))}{cell.format(escape(text))}</tr>" for name, text in facts.items())
    return f"<div><b>{escape(title)}</b><table><tbody>{rows}</tbody></table></div>"
