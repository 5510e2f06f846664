"""Digital outputs that a robot program sets at both ends of each seam.

process: {on: {5: true}, off: {5: false}}
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from htcp_jax.errors import InputError
from htcp_jax.spec import strict_model

MOST = 8  # outputs that are set at one place
LARGEST = 65535  # number of an output


def _outputs(value: Any) -> tuple[tuple[int | str, bool], ...]:
    """Return pairs of an output, by number or name, and its value.

    Raises:
        InputError: If the value is not a mapping of outputs to true or false.
    """
    pairs = [*value.items()] if isinstance(value, Mapping) else value
    rule = "valid: outputs by number, or for rapid by name, and true or false: {5: true}"
    if not isinstance(pairs, list | tuple) or not all(
        isinstance(each, list | tuple) and len(each) == 2 for each in pairs
    ):
        raise InputError(f"{value!r} is not a mapping; {rule}")
    found = []
    for output, state in pairs:
        output = int(output) if isinstance(output, str) and output.isdecimal() else output
        is_number = isinstance(output, int) and not isinstance(output, bool) and 1 <= output <= LARGEST
        if not (is_number or (isinstance(output, str) and output)) or not isinstance(state, bool):
            raise InputError(f"{{{output!r}: {state!r}}} is not an output; {rule}")
        found.append((output, state))
    if len(found) > MOST:
        raise InputError(f"{len(found)} outputs; at most {MOST} are set at one place")
    return tuple(found)


Outputs = Annotated[tuple[tuple[int | str, bool], ...], BeforeValidator(_outputs), PlainSerializer(dict)]


class ProcessConfig(strict_model.FileSection):
    """Outputs, by number or for rapid by name, and their values at both ends of each seam: {5: true}."""

    on: Outputs = Field(())  # set at the first configuration of each seam
    off: Outputs = Field(())  # set at the last configuration of each seam, and before the program's first motion

    @model_validator(mode="after")
    def _is_switched_back(self) -> "ProcessConfig":
        missing = [output for output, _ in self.on if output not in dict(self.off)]
        if missing:
            raise InputError(f"process.on sets {missing[0]}, but process.off does not; state its value in both")
        return self
