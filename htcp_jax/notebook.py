"""How things show themselves in a notebook: an object as a title and a short table of facts, a figure as a picture."""

import sys
from collections.abc import Mapping
from html import escape


def html_facts(title: str, facts: Mapping[str, str]) -> str:
    """The facts as an HTML table, a row a fact."""
    cell = '<td style="text-align: left; vertical-align: top">{}</td>'
    rows = "".join(f"<tr>{cell.format(escape(name))}{cell.format(escape(text))}</tr>" for name, text in facts.items())
    return f"<div><b>{escape(title)}</b><table><tbody>{rows}</tbody></table></div>"


def show_figures() -> None:
    """In a notebook, let a cell that returns a figure show it, as IPython does once pyplot is imported."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython
    from IPython.core.pylabtools import print_figure
    from matplotlib.figure import Figure

    if (shell := get_ipython()) is not None:
        formatters = shell.display_formatter.formatters
        if not any(Figure in formatter.type_printers for formatter in formatters.values()):
            formatters["image/png"].for_type(Figure, print_figure)
