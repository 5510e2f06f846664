"""docs/equations.md: each equation of the paper has a row, and every name in a row exists."""

import re
from dataclasses import fields
from pathlib import Path
from pkgutil import resolve_name

from htcp_jax.settings import Settings

ROOT = Path(__file__).parents[2]
# Numbers as in the paper; letters are the lines of subequations.
NUMBERS = "1 2 3 4 4a 4b 4c 4d 5 5a 5b 5c 6 7 8 9 10 11 11a 11b 11c".split()
PAGE = (ROOT / "docs/equations.md").read_text(encoding="utf-8")
TABLE = PAGE[PAGE.index("| equation |") : PAGE.index("## Readings")]
ROWS = [[cell.strip() for cell in line.split(" | ")] for line in TABLE.splitlines()[2:] if line]
FUNCTIONS = sorted(set(re.findall(r"`(htcp_jax\.[\w.]+)`", PAGE)))
TESTS = sorted(set(re.findall(r"`(test_\w+\.py)::(test_\w+)`", PAGE)))
CITED = re.compile(r"[Ee]quations? \(?(\d+[a-d]?)\b(?:\)? (?:and|to) \(?(\d+[a-d]?)\b)?")
OTHER_BOOKS = {"cma_es.py", "test_cma_es.py"}  # these cite the tutorial on CMA-ES


def test_the_table_has_the_papers_equations_in_their_order():
    assert re.findall(r"^\| \[\((\d+[a-d]?)\)\]", TABLE, re.MULTILINE) == NUMBERS


def test_every_row_names_a_function_and_a_test():
    assert len(ROWS) > len(NUMBERS)
    for _, _, functions, tests in ROWS:
        assert "`htcp_jax." in functions and "`test_" in tests


def test_every_function_of_the_page_exists():
    assert FUNCTIONS
    for name in FUNCTIONS:
        resolve_name(name)


def test_every_setting_of_the_page_exists():
    named = set(re.findall(r"`settings\.(\w+)`", PAGE))
    assert len(named) > 10 and named <= {field.name for field in fields(Settings)}


def test_every_test_of_the_page_exists():
    defined = {file: (ROOT / "tests" / file).read_text(encoding="utf-8") for file, _ in TESTS}
    assert (
        TESTS and [test for file, test in TESTS if not re.search(rf"^def {test}\(", defined[file], re.MULTILINE)] == []
    )


def test_no_file_cites_an_equation_that_the_paper_does_not_have():
    folders = "htcp_jax", "docs", "configs", "notebooks", "tests", "benchmarks"
    files, cited = [file for folder in folders for file in (ROOT / folder).rglob("*.*")], {}
    for file in files:
        if file.suffix in (".py", ".md", ".yaml") and file.name not in OTHER_BOOKS:
            numbers = sum(CITED.findall(file.read_text(encoding="utf-8")), ())
            cited |= {number: file.name for number in numbers if number}
    assert len(cited) > 8 and not cited.keys() - set(NUMBERS), cited
