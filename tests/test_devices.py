"""Choice of the device: the default, `--device`, and the message for one that is not here."""

from unittest import mock

import jax
import pytest

from htcp_jax.backend import default_device
from htcp_jax.cli import main
from htcp_jax.device.devices import choose, default_threads, on
from htcp_jax.errors import InputError


def test_the_default_is_what_jax_prefers():
    assert choose()[0] in jax.local_devices()
    assert default_threads(choose(), "clarabel") >= 1


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="here is an accelerator")
def test_without_an_accelerator_there_is_the_cpu_and_nothing_else():
    assert choose("cpu") == jax.local_devices()[:1]
    for name in ("gpu", "gpu:2", "tpu", "cpu:1", "gpu:0"):
        with pytest.raises(InputError, match=f"device is '{name}'; valid on this machine: cpu$"):
            choose(name)


@pytest.mark.parametrize("command", [["plan"], ["sweep", "robot.yaml"]])
def test_the_command_line_names_the_devices_that_there_are(command, capsys):
    assert main([*command, "--device", "gpu:9"]) == 2
    assert "device is 'gpu:9'; valid on this machine: " in capsys.readouterr().err


def test_choosing_the_cpu_leaves_jaxs_configuration_as_it_was():
    before = dict(jax.config.values)
    assert choose("cpu")[0].platform == "cpu"
    with on(choose("cpu")[0]):
        assert default_device().platform == "cpu"
    assert dict(jax.config.values) == before


def test_with_gpus_the_cpu_some_and_all_of_them_can_be_chosen(monkeypatch):
    gpus, cpu = [mock.Mock(spec=jax.Device, platform="gpu") for _ in range(2)], jax.devices("cpu")
    monkeypatch.setattr(jax, "local_devices", lambda backend=None: cpu if backend == "cpu" else gpus)
    assert choose() == choose("gpu") == choose("gpu:2") == gpus and choose("gpu:1") == gpus[:1]
    assert choose("cpu") == cpu[:1]
    with pytest.raises(InputError, match=r"device is 'gpu:3'; valid on this machine: cpu, gpu, gpu:1, gpu:2$"):
        choose("gpu:3")
