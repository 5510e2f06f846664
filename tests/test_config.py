"""Configurations: the default is the shipped file, and every mistake gives one clear line."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.settings import Settings
from htcp_jax.spec.config import PlanConfig
from htcp_jax.spec.config_file import merged

CONFIGS = Path(__file__).parents[1] / "configs"
SWEEPS = Path(__file__).parents[1] / "sweeps"


def keys(mapping: dict, prefix: str = "") -> set[str]:
    return {
        name
        for key, value in mapping.items()
        for name in (keys(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}"})
    }


def test_the_default_job_is_duct_yaml_and_that_file_lists_every_key():
    assert load_config(CONFIGS / "duct.yaml") == load_config() == PlanConfig()
    listed = yaml.safe_load((CONFIGS / "duct.yaml").read_text())
    assert keys(listed) == keys(PlanConfig().model_dump())


def test_paper_yaml_is_reading_c_with_j1_at_weight_one():
    paper = load_config(CONFIGS / "paper.yaml")
    assert paper.margin_m == 0
    chosen = paper.settings
    assert (chosen.cost_about, chosen.clearance_rows, chosen.j1_weight) == ("previous", "smallest", 1)
    assert (chosen.path_check, chosen.after_recovery) == ("none", "accept")
    assert paper.start_rad == PlanConfig().start_rad and paper.workpiece == PlanConfig().workpiece


def test_settings_paper_and_port_are_those_of_the_files_with_these_names():
    assert load_config(CONFIGS / "paper.yaml").settings == Settings.paper() != Settings()
    assert load_config(CONFIGS / "port.yaml").settings == Settings.port() != Settings.paper()
    assert replace(Settings.paper(7), q_weights=(1.0,) * 6) == Settings.paper()


def test_overrides_come_last_and_are_yaml():
    overrides = ["margin_m=1e-3", "workpiece.shift_m=[0, 0.01, 0]", "settings.seed=7"]
    config = load_config(CONFIGS / "paper.yaml", overrides)
    assert (config.margin_m, config.workpiece.shift_m, config.settings.seed) == (1e-3, (0, 0.01, 0), 7)
    assert config.settings.clearance_rows == "smallest"


def test_files_are_relative_to_the_yaml_file_and_to_the_working_folder_in_an_override(tmp_path):
    (tmp_path / "plan.yaml").write_text("workpiece: {cloud: scan.xyz, path: weld}\nstart_rad: [0]\nrobot:\n")
    config = load_config(tmp_path / "plan.yaml", ["robot.model=arm.urdf"])
    assert config.workpiece.cloud == str(tmp_path / "scan.xyz")
    assert (config.workpiece.path, config.robot.model) == ("weld", "arm.urdf")


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ("margin=0.1", "unknown key margin; did you mean margin_m?"),
        ("settings.alpha=0.1", "unknown key settings.alpha; did you mean settings.alpha_rad?"),
        ("zzz=1", "unknown key zzz; valid: robot, positioner"),
        ("settings.margin_m=0.1", "unknown key settings.margin_m; did you mean margin_m?"),
        ("near_part_speed=0.5", "unknown key near_part_speed; did you mean program.near_part_speed?"),
        ("method=a_b", "method: 'a_b' is not a method; names consist of lower-case letters, digits and hyphens"),
        ("settings.tolerance_m=0", "settings.tolerance_m is 0: at least 1e-15 is needed"),
        ("settings.tolerance_m=-1", "settings.tolerance_m is -1: at least 1e-15 is needed"),
        ("settings.q_weights=[1, 0]", "settings.q_weights.1 is 0: at least 1e-15 is needed"),
        ("settings.clearance_rows=all", "settings.clearance_rows is 'all': input should be 'per-body' or 'smallest'"),
        ("settings.qp=magic", "settings.qp: 'magic' is not a QP solver; valid: auto, clarabel"),
        ("margin_m=-0.1", "margin_m is -0.1: at least 0 is needed"),
        ("transfer_margin_m=20", "transfer_margin_m is 20: at most 1 is allowed, in metres"),
        ("transfer_margin_m=20mm", "transfer_margin_m is '20mm': a number is needed, in metres"),
        ("margin_m=.nan", "margin_m is nan: input should be a finite number"),
        ("start_rad=here", "start_rad: 'here' is not a start configuration; valid: auto, or a list of joint positions"),
        ("settings=3", "settings is 3: a mapping of keys to values is needed"),
        ("robot=[1]", "robot is [1]: a mapping of keys to values is needed"),
        ("task={point: tcp}", "task is {'point': 'tcp'}: a list is needed"),
        ("task=[3]", "task.1 is 3: a mapping of keys to values is needed"),
        ("cell.clouds=3", "cell.clouds is 3: a list is needed"),
        ("margin_m", "--set expects key=value, not 'margin_m'"),
        ("margin_m=[", "--set margin_m=[, line 1: "),
    ],
)
def test_a_wrong_value_is_named_in_one_line(override, line):
    with pytest.raises(InputError) as error:
        load_config(None, [override])
    assert line in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("overrides", "found"),
    [
        (
            ["margin=1", "settings.alpha=1", "sead=1"],
            ["unknown key margin;", "unknown key settings.alpha;", "key sead;"],
        ),
        (
            ["margin_m=-1", "settings.qp=magic", "start_rad=here"],
            ["margin_m is -1", "settings.qp: 'magic'", "start_rad"],
        ),
    ],
)
def test_several_mistakes_of_one_kind_are_named_at_once(overrides, found):
    with pytest.raises(InputError) as error:
        load_config(None, overrides)
    assert all(each in str(error.value) for each in found) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (b"margin_m: 1\nmargin_m: 2\n", "line 2: key 'margin_m' is repeated"),
        (b"- 1\n", "must be a mapping of keys to values, but is [1]"),
        (b"a: [\n", "line 2: "),
        (b"a: !!python/object/apply:os.getcwd []\n", "line 1: tag tag:yaml.org,2002:python/object/apply:os"),
        (b"\xff\xfe\x00", "it is not UTF-8 text"),
        (b"[" * 100_000, "line 1: nested too deeply"),
        (b"margin_m: 2020-13-45", "margin_m is '2020-13-45'"),
    ],
)
def test_a_damaged_file_is_named_in_one_line(tmp_path, text, line):
    file = tmp_path / "plan.yaml"
    file.write_bytes(text)
    with pytest.raises(InputError) as error:
        load_config(file)
    assert line in str(error.value) and "plan.yaml" in str(error.value) and "\n" not in str(error.value)


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"cannot read nowhere\.yaml: No such file"):
        load_config("nowhere.yaml")


SCALARS = st.none() | st.booleans() | st.floats() | st.text()


@given(st.recursive(SCALARS, lambda inner: st.dictionaries(st.text(), inner)))
def test_no_value_of_a_section_is_a_traceback(value):
    for key in ("settings", "start_rad", "robot"):
        try:
            load_config(None, [f"{key}={yaml.safe_dump(value)}"])
        except InputError:
            pass


def test_outputs_of_a_process_replace_earlier_ones_and_are_switched_back():
    first, other = (
        "program.process={on: {5: true}, off: {5: false}}",
        "program.process={on: {7: true}, off: {7: false}}",
    )
    process = load_config(None, [first, other]).program.process
    assert (process.on, process.off) == (((7, True),), ((7, False),))
    saved = load_config(None, [first]).model_dump(mode="json")
    again = PlanConfig.model_validate(merged([saved, {"program": {"process": {"on": {5: False}, "off": {5: True}}}}]))
    assert (again.program.process.on, again.program.process.off) == (((5, False),), ((5, True),))
    with pytest.raises(InputError, match=r"process\.on sets 5, but process\.off does not; state its value in both"):
        load_config(None, ["program.process={on: {5: true}}"])
