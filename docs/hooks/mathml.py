"""Formulas as MathML, written into the page when the site is built: no script, no font, nothing from the network.

pymdownx.arithmatex finds the formulas; a formula that cannot be converted stops the build.
"""

import re
from html import unescape

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(html: str, **_) -> str:
    """Called by mkdocs with every page's HTML."""
    return FORMULA.sub(_mathml, html)


def _mathml(found: re.Match) -> str:
    tag, opening, formula = found.groups()
    display = "block" if opening == "[" else "inline"
    return f"<{tag}>{convert(unescape(formula), display=display)}</{tag}>"
