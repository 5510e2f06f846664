"""Names as users import them: `::: htcp_jax.api.plan` gets the heading `htcp_jax.plan`.

Public names are those of htcp_jax/__init__.pyi; all others keep their full path. The pages in LINKED read well without
this: they name functions and settings in full, as code, which becomes links.
"""

import ast
import re
from pathlib import Path

STUB = Path(__file__).parents[2] / "htcp_jax" / "__init__.pyi"
LINKED = "equations.md", "bounds.md"
NAMED = re.compile(r"`(htcp_jax|settings)((?:\.\w+)+)`")
SHOWN = re.compile(r"^::: (htcp_jax\.[\w.]+)$(\n    options:$)?", re.MULTILINE)


def on_page_markdown(markdown: str, page=None, **_) -> str:
    """Add headings to the objects that a page shows, and links; called by mkdocs with every page's source."""
    names = public_names(STUB.read_text(encoding="utf-8"))

    def headed(found: re.Match) -> str:
        if (public := names.get(found[1])) is None:
            return found[0]
        return f"::: {found[1]}\n    options:\n      heading: {public}\n      toc_label: {public.rpartition('.')[2]}"

    full = {public: name for name, public in names.items()}

    def linked(found: re.Match) -> str:
        name = found[1] + found[2]
        if found[1] == "settings":
            return f"[`{name}`][htcp_jax.settings.Settings{found[2]}]"
        stem, _, last = name.rpartition(".")
        return f"[`{last}`][{full.get(name) or f'{full.get(stem, stem)}.{last}'}]"

    if page is not None and page.file.src_uri in LINKED:
        markdown = NAMED.sub(linked, markdown)
    return SHOWN.sub(headed, markdown)


def public_names(stub: str) -> dict[str, str]:
    """Return the public name of each object that a stub imports, by its full path."""
    imports = (node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom) and node.module)
    return {f"htcp_jax.{node.module}.{each.name}": f"htcp_jax.{each.name}" for node in imports for each in node.names}
