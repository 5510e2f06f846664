"""The page of arms that were tried, and the record from which it is generated."""

import json

import yaml

from benchmarks import arm_files

RECORD = json.loads(arm_files.RECORD.read_text(encoding="utf-8"))


def test_the_page_is_that_of_the_record():
    """If this fails: python -m benchmarks arm-files --page."""
    assert arm_files.PAGE.read_text(encoding="utf-8") == arm_files.page(RECORD)


def test_the_record_has_every_arm_of_the_list_and_no_other():
    listed = yaml.safe_load(arm_files.LIST.read_text(encoding="utf-8"))
    files = [(package, file) for package, own in listed.items() for *_, file in own["arms"]]
    assert [(each["package"], each["file"]) for each in RECORD["arms"]] == files


def test_no_recorded_arm_differs_silently():
    assert not [each["arm"] for each in RECORD["arms"] if arm_files.is_wrong(each)]


def test_at_least_75_of_80_files_of_15_makers_are_imported():
    arms = RECORD["arms"]
    imported = sum("refused" not in each for each in arms)
    assert len(arms) >= 80 and len({each["maker"] for each in arms}) >= 15 and imported / len(arms) >= 75 / 80


def test_every_refusal_is_confirmed_by_an_independent_reading():
    assert all(each["evidence"] or "error" in each for each in RECORD["arms"] if "refused" in each)


def test_a_difference_without_a_message_is_wrong():
    found = {"messages": [], "limits": {}, "lost": [], "position_m": 0.0, "rotation": 0.0}
    assert not arm_files.is_wrong(found)
    assert arm_files.is_wrong(found | {"limits": {"j1": [0, 1, 0, 2]}})
    rare = found | {"clear": 0.5, "clear_by_meshes": 0.6}
    assert arm_files.is_wrong(rare | {"named": []}) and not arm_files.is_wrong(rare | {"named": ["a and b (10.0%)"]})
    assert not arm_files.is_wrong(found | {"limits": {"j1": [0, 1, 0, 2]}, "messages": ["soft limits of j1"]})
    assert arm_files.is_wrong(found | {"position_m": 1e-6}) and arm_files.is_wrong(found | {"lost": ["j2"]})
