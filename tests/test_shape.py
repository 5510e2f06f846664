"""The shape of the source, by `benchmarks.shape`: how deep imports go, how large files, classes and functions are."""

from pathlib import Path

import pytest

from benchmarks.shape import Tree, spread

ROOT = Path(__file__).parents[1]

TREE = Tree("here", ROOT)
DEEPEST, LARGEST_CLASS, FILES, BODY, BODY_P90 = 12, 200, (100, 220), 6, 19


def test_the_longest_chain_of_imports_is_short():
    assert not TREE.circles and len(TREE.chain) <= DEEPEST, " > ".join(TREE.chain)


def test_folders_import_one_way():
    assert TREE.arrows and not TREE.arrows_back


def test_no_class_is_long():
    assert not {name: lines for name, lines in TREE.classes.items() if lines > LARGEST_CLASS}


def test_files_are_neither_scraps_nor_scrolls():
    low, high = FILES
    assert low <= spread(TREE.files).median <= high


def test_functions_are_short():
    assert spread(TREE.bodies).median <= BODY and spread(TREE.bodies).p90 <= BODY_P90


@pytest.fixture
def made(tmp_path):
    """A package of two folders that import each other inside functions alone, and a class of ten lines."""
    package = tmp_path / "htcp_jax"
    files = {
        "__init__.py": "",
        "low/__init__.py": '"""Nothing else."""\n',
        "low/a.py": '"""A.\n\nMore."""\n\nimport math  # pi\n\n\ndef late():\n    from htcp_jax.high import b\n',
        "high/__init__.py": "",
        "high/b.py": "from htcp_jax.low.a import late\nfrom htcp_jax import low\n",
        "high/c.py": "from htcp_jax.high.b import late\n\n\nclass C:\n" + "    x = 1\n" * 9,
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    return Tree("made", tmp_path)


def test_what_is_counted_is_what_the_definitions_say(made):
    assert made.chain == ["high.c", "high.b", "low.a"]  # not back into `high`, which is imported late
    assert made.arrows == {("high", "low")} and not made.arrows_back
    assert made.classes == {"high.c.C": 10} and made.bodies == [2]
    assert sorted(made.files) == [2, 9, 13]  # without the `__init__`s, which hold at most a docstring
    assert made.share(lambda source: source.docstrings) == pytest.approx(100 * 4 / 19)
    assert made.share(lambda source: source.comments) == pytest.approx(100 / 19)


def test_a_circle_is_found(made):
    file = made.root / "htcp_jax/low/a.py"
    file.write_text("from htcp_jax.high.b import late\n")
    again = Tree("again", made.root)
    assert set(again.circles) == {"low.a", "high.b"} and not again.chain and again.arrows_back == 2
