"""`htcp doctor`: versions, devices, rendering, and a self-test by a plan with a known result."""

from rich.text import Text

from htcp_jax.cli.output import Json, print_facts, print_json, stdout
from htcp_jax.cli.self_test import examine

SOUND, UNSOUND = 0, 1


def doctor(as_json: Json = False) -> int:
    """Check the installation: versions, devices, rendering, compile cache, and a short plan with a known result.

    Takes about 2 s, and longer the first time, because functions are compiled. Writes only to the compile cache.

    Exit codes: 0 if the self-test passes (rendering may be missing: no plan needs it), 1 if it fails.

    \b
    Examples:
      htcp doctor                               before the first plan, and for a bug report
      htcp doctor --json                        for another program
    """
    found = examine()
    if as_json:
        print_json(found)
    else:
        _print_verdict(found)
    return SOUND if found["sound"] else UNSOUND


def _print_verdict(found: dict) -> None:
    cache, cores, test = found["cache"], found["cores"], found["self_test"]
    versions = ", ".join(f"{name} {version or '(not installed)'}" for name, version in found["versions"].items())
    kept = "no cache; every start compiles again"
    if cache is not None:
        kept = f"{cache['folder']}, {cache['files']:,} files, {cache['bytes'] / 1e6:.1f} MB"
    prepared = "yes" if cache and cache["prepared"] else "no; htcp prepare compiles what first plans wait for"
    facts = {
        "python": f"{found['python']} on {found['system']}",
        "versions": versions,
        "devices": ", ".join(found["devices"]),
        "cores": f"{cores['usable']} usable of {cores['of_machine']}",
        "numbers": found["dtype"],
        "rendering": found["rendering"]["platform"] or found["rendering"]["lacks"],
        "compiled programs": kept,
        "prepared": prepared,
        "self-test": f"{test['description']}; {test['seconds']:.1f} s, {test['compile_s']:.1f} s of them compiling",
    }
    print_facts("htcp doctor", facts)
    verdict = ("sound", "bold green") if found["sound"] else ("the self-test failed", "bold red")
    stdout().print(Text(*verdict))
