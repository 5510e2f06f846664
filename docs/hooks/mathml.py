"""Formulas as MathML, written into the page when the site is built: no script, nothing from the network.

pymdownx.arithmatex finds the formulas. One with braces that do not match or with a command that the converter does not
know, which it would print as it stands, stops the build.
"""

import re
from html import unescape

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

# Brackets that browsers would stretch to a formula's height, but not those that have an exponent
SMALL = re.compile(r'<mo(?: stretchy="true" fence="true" minsize="1.2em" maxsize="1.2em")?>(&#x02016;|[()])</mo>')
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(html: str, **_) -> str:
    """Called by mkdocs with every page's HTML."""
    return FORMULA.sub(_mathml, html)


def _mathml(found: re.Match) -> str:
    tag, opening, escaped = found.groups()
    formula = unescape(escaped)
    mathml = convert(formula, display="block" if opening == "[" else "inline")
    if "\\" in mathml or formula.count("{") != formula.count("}"):
        raise PluginError(f"no formula: {formula.strip()}")
    mathml = SMALL.sub(r'<mo stretchy="false">\1</mo>', mathml)
    return f"<{tag}>{mathml}</{tag}>"
