"""The page of strangers' jobs, and the record from which it is generated."""

import json

import yaml

from benchmarks import strangers

RECORD = json.loads(strangers.RECORD.read_text(encoding="utf-8"))


def test_the_page_is_that_of_the_record():
    """If this fails: python -m benchmarks strangers --page."""
    assert strangers.PAGE.read_text(encoding="utf-8") == strangers.page(RECORD)


def test_the_record_has_every_job_of_the_list_and_no_other():
    listed = yaml.safe_load(strangers.JOBS.read_text(encoding="utf-8"))["jobs"]
    assert [each["name"] for each in RECORD["jobs"]] == list(listed) and len(listed) >= 24


def test_all_recorded_verdicts_are_true():
    assert not [each["name"] for each in RECORD["jobs"] if not strangers.is_true(each)]


def test_a_contact_or_a_counterexample_is_a_false_verdict():
    found = {"motion": {"is_true": True}, "reach": {"is_true": True}}
    assert strangers.is_true(found)
    assert not strangers.is_true(found | {"motion": {"is_true": False}})
    assert not strangers.is_true(found | {"reach": {"is_true": False}})
    assert not strangers.is_true({"refused": "plan: htcp: a line"})
