"""Protects the site as it is read from the disk, without the network: its search, and its layout at three widths."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WIDTHS = 1280, 768, 400
PAGES = "index", "equations", "timing", "reference/configuration", "reference/json"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(words, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True)
    return folder


def test_search_works_from_the_disk(site, browser):
    page, failed = browser.new_page(), []
    page.on("requestfailed", lambda request: failed.append(request.url))
    page.goto((site / "index.html").as_uri())
    page.wait_for_timeout(500)
    page.keyboard.press("f")
    page.wait_for_timeout(500)
    page.keyboard.type("manipulability")
    page.wait_for_selector(".md-search-result__link")
    page.close()
    assert failed == []


def test_no_page_scrolls_sideways(site, browser):
    for width in WIDTHS:
        page = browser.new_page(viewport={"width": width, "height": 900})
        for name in PAGES:
            page.goto((site / f"{name}.html").as_uri())
            beyond = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert beyond <= 0, (name, width)
        page.close()


def test_the_copy_button_covers_no_code_until_the_pointer_is_over_it(site, browser):
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto((site / "commands.html").as_uri())
    button = page.locator(".md-code__nav").first
    opacity = "each => getComputedStyle(each).opacity"
    assert button.evaluate(opacity) == "0"
    page.locator("pre").first.hover()
    assert button.evaluate(opacity) == "1"
    page.close()


def test_the_text_of_a_table_of_keys_is_not_a_column_of_single_words_at_400_px(site, browser):
    page = browser.new_page(viewport={"width": 400, "height": 900})
    page.goto((site / "reference/json.html").as_uri())
    widths = page.locator("td:last-child").evaluate_all("cells => cells.map(each => each.clientWidth)")
    assert min(widths) > 100
    page.close()
