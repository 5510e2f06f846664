"""Protects the generated tables of the documentation: every key of a job is listed, with its meaning."""

import re
import sys
from pathlib import Path

import pytest
import yaml

import htcp_jax
from htcp_jax import status
from htcp_jax.spec import keys_of

HOOKS = Path(__file__).parents[1] / "docs" / "hooks"


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(HOOKS)
    yield pytest.importorskip("tables")
    sys.modules.pop("tables")


def test_the_table_lists_every_key_of_the_default_job_with_its_meaning(tables):
    job = yaml.safe_load(tables.JOB.read_text())
    sections = {name for name, value in job.items() if isinstance(value, dict)}
    listed = tables.job_keys()
    assert {key.name for key in listed} == keys_of(job) - sections
    assert [key.name for key in listed if not key.meaning] == []


def test_a_comment_that_goes_on_below_belongs_to_the_key_above(tables):
    text = "first:\n  a: 1 # one,\n  # or two\n  # a heading\n\n  b: 2\nc: 3 # three\n"
    assert tables.meanings(text) == {"first.a": "one, or two a heading", "first.b": "", "c": "three"}


def test_the_tables_of_statuses_list_every_member_with_its_message(tables):
    page = tables.filled("<!-- generated: statuses Status -->\n<!-- generated: statuses SegmentStatus -->\n")
    for each in (*status.Status, *status.SegmentStatus):
        assert f"| `{each.name}` | {each.message}" in page


def test_objects_are_shown_by_the_names_that_users_import(monkeypatch):
    monkeypatch.syspath_prepend(HOOKS)
    hook = pytest.importorskip("public_names")
    page = hook.on_page_markdown(
        "::: htcp_jax.api.plan\n::: htcp_jax.runs.run_folder.Run\n    options:\n      members: []\n"
    )
    shown, own = page.split("::: htcp_jax.runs")
    assert "heading: htcp_jax.plan\n      toc_label: plan\n" in shown and "heading" not in own
    for name in hook.public_names(hook.STUB.read_text()).values():
        assert hasattr(htcp_jax, name.rpartition(".")[2])


def test_the_start_page_is_readme_with_links_of_the_site(monkeypatch):
    monkeypatch.syspath_prepend(HOOKS)
    hook = pytest.importorskip("readme")
    page = hook.on_page_markdown((HOOKS.parent / "index.md").read_text())
    links = [link.partition("#")[0] for link in re.findall(r"\]\((?!https?:)([^)]+)\)", page)]
    assert "make demo" in page and len(links) > 30
    assert [link for link in links if not (HOOKS.parent / link).is_file()] == []


def test_every_page_with_generated_parts_says_so_and_the_site_does_not(tables):
    """Regression: such a page looks empty on a code host."""
    generated = re.compile(r"^(::: |--8<-- )", re.MULTILINE)
    for page in sorted(HOOKS.parent.rglob("*.md")):
        text = page.read_text()
        outside_of_blocks = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
        assert (tables.NOTE in text) == bool(generated.search(outside_of_blocks)), page.name
        assert tables.NOTE not in tables.on_page_markdown(text)


def test_the_generated_parts_of_the_pages_are_up_to_date(tables):
    """`python docs/hooks/tables.py` writes them; a code host shows the pages as they are."""
    pages = {page: page.read_text() for page in sorted(HOOKS.parent.rglob("*.md"))}
    assert sum("<!-- generated: " in text for text in pages.values()) >= 7
    assert [page.name for page, text in pages.items() if tables.filled(text) != text] == []
    assert tables.filled("<!-- generated: statuses Status -->\nold\n" + tables.END).count("old") == 0
