"""Choice of the device: the default, `--device`, and the message for one that is not here."""

import jax
import pytest

from htcp_jax.cli.main import main
from htcp_jax.device.devices import choose, default_threads
from htcp_jax.errors import InputError


def test_the_default_is_what_jax_prefers():
    assert choose()[0] in jax.local_devices()
    assert default_threads(choose(), "clarabel") >= 1


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="here is an accelerator")
def test_without_an_accelerator_there_is_the_cpu_and_nothing_else():
    assert choose("cpu") == jax.local_devices()[:1]
    for name in ("gpu", "gpu:2", "tpu", "cpu:1", "gpu:0"):
        with pytest.raises(InputError, match=f"device is '{name}'; valid here: cpu$"):
            choose(name)


@pytest.mark.parametrize("command", [["plan"], ["sweep", "robot.yaml"]])
def test_the_command_line_names_the_devices_that_there_are(command, capsys):
    assert main([*command, "--device", "gpu:9"]) == 2
    assert "device is 'gpu:9'; valid here: " in capsys.readouterr().err
