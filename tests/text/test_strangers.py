"""The page of strangers' jobs, and the record from which it is generated."""

import json

import yaml

from benchmarks import strangers

RECORD = json.loads(strangers.RECORD.read_text(encoding="utf-8"))


def test_the_page_is_that_of_the_record():
    """If this fails: python -m benchmarks strangers --page."""
    assert strangers.PAGE.read_text(encoding="utf-8") == strangers.page(RECORD)


def test_the_record_has_jobs_of_the_list_in_its_order():
    listed = yaml.safe_load(strangers.JOBS.read_text(encoding="utf-8"))["jobs"]
    recorded = [each["name"] for each in RECORD["jobs"]]
    assert recorded == [name for name in listed if name in recorded] and len(listed) >= 24


def test_the_page_says_why_a_verdict_is_not_true():
    wrong = [each for each in RECORD["jobs"] if not strangers.is_true(each)]
    assert all(strangers.ending(each) in strangers.PAGE.read_text(encoding="utf-8") for each in wrong)


def test_no_recorded_motion_touches_anything_and_no_exclusion_has_a_counterexample():
    assert not [each["name"] for each in RECORD["jobs"] if "motion" in each and not each["motion"]["is_true"]]
    assert not [each["name"] for each in RECORD["jobs"] if "reach" in each and not each["reach"]["is_true"]]


def test_a_contact_or_a_counterexample_is_a_false_verdict():
    found = {"motion": {"is_true": True}, "reach": {"is_true": True}, "executable": 3, "targets": 4}
    assert strangers.is_true(found)
    assert not strangers.is_true(found | {"motion": {"is_true": False}})
    assert not strangers.is_true(found | {"reach": {"is_true": False}})
    assert not strangers.is_true({key: value for key, value in found.items() if key != "reach"})
    assert not strangers.is_true({"refused": "plan: htcp: a line"})
