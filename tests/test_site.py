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
