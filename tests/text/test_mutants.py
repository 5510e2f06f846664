"""benchmarks/mutants.yaml describes faults of today's source."""

import pytest
import yaml

from benchmarks.mutants import LIST, ROOT, mutated

MUTANTS = {each["number"]: each for each in yaml.safe_load(LIST.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("number", MUTANTS)
def test_the_lines_of_a_mutant_are_in_the_package_once(number):
    file, text = mutated(ROOT, MUTANTS[number])
    assert text != file.read_text(encoding="utf-8")


def test_the_test_files_of_mutants_exist():
    assert [file for each in MUTANTS.values() for file in each["tests"] if not (ROOT / file).is_file()] == []
