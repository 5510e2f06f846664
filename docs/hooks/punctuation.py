"""Punctuation stays on the line of its code: assets/site.css shows code as a box, and a line may break beside a box."""

import re

BESIDE = re.compile(r"(?:\(<code>[^<]*</code>|<code>[^<]*</code>(?=[.,;:)]))[.,;:)]*")


def on_page_content(html: str, **_) -> str:
    """Put code and the punctuation beside it into one element; called by mkdocs with every page's HTML."""
    return BESIDE.sub(r'<span class="with-code">\g<0></span>', html)
