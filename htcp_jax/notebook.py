"""Display in notebooks: objects as a title with a short table, matplotlib figures as pictures."""

import sys
from collections.abc import Mapping
from html import escape


def html_facts(title: str, facts: Mapping[str, str]) -> str:
    """Return an HTML title and a table with one row per fact.

    Args:
        title: The title, as plain text.
        facts: Text by label. Labels and text are escaped.
    """
    cell = '<td style="text-align: left; vertical-align: top">{}</td>'
    rows = "".join(f"<tr>{cell.format(escape(name))}{cell.format(escape(text))}</tr>" for name, text in facts.items())
    return f"<div><b>{escape(title)}</b><table><tbody>{rows}</tbody></table></div>"


def show_figures() -> None:
    """Register PNG display of matplotlib figures with IPython, as pyplot does; do nothing outside of IPython."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython
    from IPython.core.pylabtools import print_figure
    from matplotlib.figure import Figure

    if (shell := get_ipython()) is not None:
        formatters = shell.display_formatter.formatters
        if not any(Figure in formatter.type_printers for formatter in formatters.values()):
            formatters["image/png"].for_type(Figure, print_figure)
