"""The start page shows README.md, whose links are relative to the repository; here they become links of the site."""

from pathlib import Path

README = Path(__file__).parents[2] / "README.md"
INCLUDED = '--8<-- "README.md"'
LINKS = {"](docs/": "](", "](CONTRIBUTING.md": "](contributing.md", "](CHANGELOG.md": "](changelog.md"}


def on_page_markdown(markdown: str, **_) -> str:
    """Fill README into the page that includes it; called by mkdocs with every page's source."""
    if INCLUDED not in markdown:
        return markdown
    _, text = README.read_text(encoding="utf-8").split("\n", 1)  # the page has a title of its own
    for of_repository, of_site in LINKS.items():
        text = text.replace(of_repository, of_site)
    return markdown.replace(INCLUDED, text)
