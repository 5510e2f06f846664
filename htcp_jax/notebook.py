"""Notebook display: objects as a title and a short table of facts, figures as pictures."""

import sys
from collections.abc import Mapping
from html import escape


def html_facts(title: str, facts: Mapping[str, str]) -> str:
    """Return the facts as an HTML table, one row per fact."""
    cell = '<td style="text-align: left; vertical-align: top">{}</td>'
    rows = "".join(f"<tr>{cell.format(escape(name))}{cell.format(escape(text))}</tr>" for name, text in facts.items())
    return f"<div><b>{escape(title)}</b><table><tbody>{rows}</tbody></table></div>"


def show_figures() -> None:
    """Let a notebook cell that returns a figure display it, as IPython does once pyplot is imported."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython
    from IPython.core.pylabtools import print_figure
    from matplotlib.figure import Figure

    if (shell := get_ipython()) is not None:
        formatters = shell.display_formatter.formatters
        if not any(Figure in formatter.type_printers for formatter in formatters.values()):
            formatters["image/png"].for_type(Figure, print_figure)
