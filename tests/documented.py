"""Shell and Python blocks of the README and the documentation, and how each of them is tested.

A block may have a comment before it, `<!-- runs: HOW -->`:

    (none)                   by a quick test, unchanged; a command of several pages, on the first of them
    slow                     by a slow test, unchanged
    slow, exit N             by a slow test, unchanged; each command ends with exit code N, 1 to 3
    slow, two scenarios      by a slow test, with --limit 2: it would take longer than all other tests together
    slow, in a fresh copy    by a slow test, in a copy of the repository without a virtual environment
    in CI                    by .ci/run, which is made of such commands
    suite                    it is itself part of the tests
    in an installed package  by `test_added_kinds`, which makes a package of the page's blocks
    not: REASON              not run

Blocks of other kinds are tested without being run. YAML without a file name is part of a job, whose keys are checked;
after the mark `<!-- generated: file FILE -->` a block equals that file. `text` is output, unless it has commands after
`$`.

Commands within sentences are checked against the existing commands and options, targets of make and extras. Those that
name files also run, in a slow test.

`python tests/documented.py` lists them all.
"""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
QUICK, SLOW, TWO, COPY = "quick", "slow", "slow, two scenarios", "slow, in a fresh copy"
CI, SUITE, INSTALLED = "in CI", "suite", "in an installed package"
FAILING = {f"slow, exit {code}": code for code in (1, 2, 3)}
WAYS = QUICK, SLOW, *FAILING, TWO, COPY, CI, SUITE, INSTALLED
NOT = re.compile(r"not: .+")  # the reason is part of it
FENCE = re.compile(
    r"(?:^<!-- runs: (?P<how>[^\n]*?) -->\n|^<!-- generated: file (?P<file>\S+) -->\n\n)?"
    r"^```(?P<kind>[^\n`]*)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
FILE = re.compile(r'(?:yaml|xml) title="(?P<name>[^"]+)"')


class Block(NamedTuple):
    """A fenced block of a page."""

    page: str
    kind: str  # sh, python, yaml or xml with or without the name of its file, text, ...
    text: str
    how: str
    file: str  # the file that it equals; "" for none

    @property
    def commands(self) -> list[str]:
        """The lines of a shell block without their comments."""
        words = (shlex.split(line, comments=True) for line in self.text.splitlines())
        return [shlex.join(line) for line in words if line]


def pages() -> list[str]:
    """Paths of all documentation pages, relative to the root of the repository."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [str(path.relative_to(ROOT)) for path in found]


def fences(page: str) -> list[Block]:
    """All fenced blocks of a page, in order."""
    found = FENCE.finditer((ROOT / page).read_text(encoding="utf-8"))
    return [Block(page, m["kind"].strip(), m["text"], m["how"] or QUICK, m["file"] or "") for m in found]


def blocks(page: str) -> list[Block]:
    """Blocks of a page that are run or written to a file, in order, without files that include snippets."""
    found = fences(page)
    return [b for b in found if b.kind in ("sh", "python") or (FILE.match(b.kind) and "--8<--" not in b.text)]


def in_sentences(page: str) -> list[str]:
    """Commands within sentences, in the order of the page."""
    text = re.sub(r"^```.*?^```$", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return [" ".join(found.split()) for found in re.findall(r"`((?:htcp|make|\.venv/bin/pip) [^`]+)`", text)]


def runs(command: str) -> bool:
    """True if a command within a sentence is complete and can be run, False if it is only mentioned."""
    return command == "htcp plan" or (command.startswith("htcp ") and "/" in command)


def indented_commands(page: str) -> list[str]:
    """Commands in indented blocks, which no test runs."""
    text = re.sub(r"^```.*?^```$", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"^ {4}((?:htcp|make|python|pip|git|\.venv/bin)\b[^\n]*)$", text, flags=re.MULTILINE)


if __name__ == "__main__":
    for page in pages():
        for block in blocks(page):
            lines = block.commands if block.kind == "sh" else [f"({block.kind} block)"]
            for line in lines:
                print(f"{page:<28}{block.how:<24}{line}")
        for command in in_sentences(page):
            print(f"{page:<28}{'slow' if runs(command) else 'is there':<24}{command}")
