"""Count the words of the README and the documentation's pages: `python tests/page_words.py`.

Prose, headings, lists and tables count. Not counted are code blocks, comments, parts that `docs/hooks/tables.py`
generates, and the pages that a benchmark generates as a whole.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST = 2500  # words of a page
GENERATED = "arms-tried.md", "strangers.md"  # by `python -m benchmarks arm-files --page`, and `strangers --page`
NOT_COUNTED = re.compile(
    r"^<!-- generated:.*?^<!-- end of the generated part -->$|^(?P<fence>```+).*?^(?P=fence)$|<!--.*?-->",
    re.DOTALL | re.MULTILINE,
)
WORD = re.compile(r"\S*\w\S*")


def pages() -> list[Path]:
    """Return the README and every page of the documentation that is written by hand."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if page.name not in GENERATED]


def words(markdown: str) -> int:
    """Return the number of words in a page's source."""
    return len(WORD.findall(NOT_COUNTED.sub("", markdown)))


if __name__ == "__main__":
    counts = {str(page.relative_to(ROOT)): words(page.read_text(encoding="utf-8")) for page in pages()}
    for name, count in sorted(counts.items(), key=lambda item: -item[1]):
        print(f"{count:6,}  {name}" + "  above the limit" * (count > MOST))
    print(f"{sum(counts.values()):6,}  in total")
