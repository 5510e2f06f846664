"""The length of the documentation's pages, as `python tests/page_words.py` counts it."""

from page_words import MOST, pages, words


def test_no_page_has_more_words_than_a_reader_reads_at_once():
    counted = {page.name: words(page.read_text(encoding="utf-8")) for page in pages()}
    assert len(counted) > 40
    assert {name: count for name, count in counted.items() if count > MOST} == {}


def test_words_of_code_comments_and_generated_parts_are_not_counted():
    code, table = "<!-- runs: slow -->\n```sh\nhtcp plan\n```\n", "| key | meaning |\n|---|---|\n| `a_m` | 3 mm - |\n"
    assert words(f"# A title\n\n{code}\n{table}") == len("A title key meaning `a_m` 3 mm".split())
    generated = "<!-- generated: statuses Status -->\n\n| a | b |\n\n<!-- end of the generated part -->\n"
    assert words(f"{generated}after it") == 2
