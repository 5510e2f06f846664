"""Packages made of the blocks of a page, docs/add-*.md, and installed as a stranger would install them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from documented import INSTALLED, blocks

ROOT = Path(__file__).parents[1]
FILE = re.compile(rf'^<!-- runs: {INSTALLED} -->\n```\w+ title="(?P<name>[^"]+)"\n(?P<text>.*?)^```$', re.S | re.M)


def files(page: str) -> dict[str, str]:
    """Return the files that a page shows, by name."""
    return {m["name"]: m["text"] for m in FILE.finditer((ROOT / page).read_text(encoding="utf-8"))}


def install(page: str, folder: Path) -> Path:
    """Build and install the page's package into a folder of its own below `folder`, and return that."""
    source, target = folder / "source", folder / "packages"
    source.mkdir(parents=True)
    for name, text in files(page).items():
        if name == "pyproject.toml" or name.startswith("my_"):
            (source / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", str(target)]
    done = subprocess.run([*pip, str(source)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


class Place:
    """A working folder with a page's jobs, and commands run in it by a Python that has the page's package."""

    def __init__(self, page: str, folder: Path):
        self.folder, self.page = folder / "work", page
        self.folder.mkdir(parents=True)
        for name, text in files(page).items():
            if name.endswith(".yaml") or name == "from_python.py":
                (self.folder / name).write_text(text)
        paths = install(page, folder), ROOT
        self.environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}

    def python(self, *words: str) -> tuple[int, str, str]:
        """Run Python; return the exit code, stdout and stderr."""
        how = {"cwd": self.folder, "env": self.environment, "capture_output": True, "text": True}
        done = subprocess.run([sys.executable, *words], **how)
        return done.returncode, done.stdout, done.stderr

    def htcp(self, *words: str) -> tuple[int, str, str]:
        """Run the command."""
        return self.python("-m", "htcp_jax", *words)

    @property
    def commands(self) -> list[list[str]]:
        """The words of the page's commands, without htcp."""
        lines = [line for block in blocks(self.page) if block.how == INSTALLED for line in block.commands]
        return [shlex.split(line)[1:] for line in lines if line.startswith("htcp ")]
