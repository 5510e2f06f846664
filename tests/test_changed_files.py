"""What a user's file states is used, refused, or named: 1,000 files with one change each."""

import pytest
from changed_files import FINE, KINDS, SAMPLES, Change, change_of, cuts, outcome, unchanged

CHANGES = 1000
# A header alone is no error of the reader, nor is a shorter job; `test_cut_files` cuts parts and clouds.
NOT_CUT = {"path", "path with quaternions", "job", "OBJ", "STL", "PLY", "PLY cloud"}


@pytest.mark.parametrize("name", KINDS)
def test_a_change_of_a_file_changes_the_result_or_is_refused_or_is_named(name, tmp_path):
    changes = [change_of(name, seed) for seed in range(-(-CHANGES // len(KINDS)))]
    found = [(change.description, outcome(name, tmp_path, change)) for change in changes]
    assert [each for each in found if each[1] not in FINE] == []


@pytest.mark.parametrize("name", [name for name in KINDS if name not in NOT_CUT])
def test_a_cut_file_is_refused_or_named(name, tmp_path):
    found = {cut[-20:]: outcome(name, tmp_path, Change("cut", cut, is_renamed=False)) for cut in cuts(name)}
    assert {end: what for end, what in found.items() if what not in ("refused", "named")} == {}


def test_a_lost_change_is_found(tmp_path):
    """The control: a remark in a mesh changes nothing, and no reader names it."""
    text = SAMPLES["part.obj"].replace("a prism", "two prisms")
    assert outcome("OBJ", tmp_path, change_of("OBJ", 0)._replace(text=text)) == "lost"


@pytest.mark.parametrize("name", KINDS)
def test_the_unchanged_file_is_read(name, tmp_path):
    assert unchanged(name, tmp_path)[0]
