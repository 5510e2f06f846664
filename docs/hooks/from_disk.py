"""Search on pages opened from the disk, without the network: the theme's script for it is served by the site itself."""

from mkdocs.exceptions import PluginError
from mkdocs.utils import get_relative_url

SHIM = "https://unpkg.com/iframe-worker/shim"
OWN = "assets/iframe-worker.js"


def on_post_page(output: str, *, page, **_) -> str:
    """Replace the script's address; called by mkdocs with every finished page."""
    if SHIM not in output:
        raise PluginError(f"the theme no longer loads {SHIM}")
    return output.replace(SHIM, get_relative_url(OWN, page.url))


def on_post_template(output: str, *, template_name: str, **_) -> str:
    """Replace the script's address; called by mkdocs with pages that are no Markdown, such as 404.html."""
    return output.replace(SHIM, f"/{OWN}") if template_name.endswith(".html") else output
