"""Malicious folders of a run, a plan and a search, and the commands that open them.

python hostile.py WORDS...    runs this command line; prints its exit code, its stderr output, and the peak of
                              memory [bytes] as JSON
"""

import hashlib
import io
import json
import os
import sys
import zipfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from htcp_jax.runs.identity import config_hash, identity

SHARD = "targets/baseline-000000-000001.parquet"
TIMES, REACHABLE, CHECKED = "timing/baseline.parquet", "reachability.json", "validation.json"
MIB = 2**20


class Kind(NamedTuple):
    """A change to a folder, and the commands that have to refuse it; the others do not have to read the file."""

    of: str  # run, plan or search
    spoil: Callable[[Path, Path], None]  # (folder, outside); the folder `outside` must stay unchanged
    refused_by: tuple[str, ...]
    named: str  # text that their error line must contain


def replaced(name: str, make: Callable[[Path, Path], None]) -> Callable[[Path, Path], None]:
    """Return a function that replaces a file by what `make` creates."""

    def spoil(folder: Path, outside: Path) -> None:
        file = folder / name
        file.parent.mkdir(exist_ok=True)
        data = file.read_bytes() if file.exists() else b"{}"
        file.unlink(missing_ok=True)
        (outside / "own").write_bytes(data)
        make(file, outside)

    return spoil


def text(content: str) -> Callable[[Path, Path], None]:
    return lambda file, _: file.write_text(content)


def sparse(file: Path, _: Path) -> None:
    """Write a sparse file: 100 GB of zeros that use no disk space."""
    with file.open("wb") as stream:
        stream.truncate(100 * 2**30)


def changed(name: str, *keys: str | int, to: object) -> Callable[[Path, Path], None]:
    """Return a function that changes one value of a JSON file."""

    def spoil(folder: Path, _: Path) -> None:
        record = within = json.loads((folder / name).read_text())
        for key in keys[:-1]:
            within = within[key]
        within[keys[-1]] = to
        (folder / name).write_text(json.dumps(record).replace('"HUGE"', "1e999").replace('"WIDE"', str(2**65)))

    return spoil


def listed(rows: pa.Table | None = None, data: bytes | None = None, promised: int | None = None):
    """Return a function that replaces a shard and makes the manifest agree: size, SHA-256, and number of rows."""

    def spoil(folder: Path, _: Path) -> None:
        file, content = folder / SHARD, data
        if content is None:
            own = pq.read_table(file)
            made = rows if rows is not None else own.take(pa.array(np.zeros(promised, np.int64)))
            pq.write_table(made, file, compression="zstd")
            content = file.read_bytes()
        file.write_bytes(content)
        manifest = json.loads((folder / "manifest.json").read_text())
        (shard,) = (s for s in manifest["shards"] if s["method"] == "baseline" and s["first"] == 0)
        shard["targets"] |= {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        shard["targets"]["rows"] = promised or shard["targets"]["rows"]
        (folder / "manifest.json").write_text(json.dumps(manifest))

    return spoil


def long_words(folder: Path, outside: Path) -> None:
    """Write a word of 4 MB, stored once, into every row."""
    rows = pq.read_table(folder / SHARD)
    place = rows.schema.get_field_index("segment_status")
    words = pa.array(["x" * (4 * MIB)] * len(rows)).cast(rows.schema.field("segment_status").type)
    listed(rows.set_column(place, rows.schema.field("segment_status"), words))(folder, outside)


def archive(size: int, shape: str | None = None) -> Callable[[Path, Path], None]:
    """Return a function that writes an .npz file with an array of zeros; shape: the shape in its header."""

    def make(file: Path, outside: Path) -> None:
        stream = io.BytesIO()
        np.save(stream, np.zeros(8))
        header = stream.getvalue()[:128].replace(b"(8,), }    ", f"({shape or size // 8},), }}".encode().ljust(11))
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as written:
            with written.open("x.npy", "w", force_zip64=True) as entry:
                entry.write(header)
                for _ in range(size // MIB):
                    entry.write(bytes(MIB))

    return make


def linked_folder(name: str) -> Callable[[Path, Path], None]:
    """Return a function that replaces a subfolder by a link to another folder."""

    def spoil(folder: Path, outside: Path) -> None:
        if (folder / name).exists():
            (folder / name).rename(outside / name)
        else:
            (outside / name).mkdir()
        (folder / name).symlink_to(outside / name)

    return spoil


def of_another_run(folder: Path, _: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["joints"] = [f"other{k}_rad" for k in range(6)]
    (folder / "manifest.json").write_text(json.dumps(manifest))


def device_named(folder: Path, _: Path) -> None:
    """Add a device to the files of a run, with a matching configuration hash."""
    record = json.loads((folder / "manifest.json").read_text())
    record["files"]["/dev/zero"] = "0"
    same = identity(record["config"], record["grid"], record["dtype"], record["files"])
    (folder / "manifest.json").write_text(json.dumps(record | {"config_hash": config_hash(same)}))


ANYTHING = {
    "pipe": lambda file, _: os.mkfifo(file),
    "device": lambda file, _: file.symlink_to("/dev/zero"),
    "link": lambda file, outside: file.symlink_to(outside / "own"),
    "sparse": sparse,
}
JSONS = ANYTHING | {
    "deep": text("[" * 200_000 + "]" * 200_000),
    "values": text("[" + "[]," * 6_000_000 + "[]]"),
    "infinite": text('{"a": 1e999}'),
    "wide": text('{"a": 36893488147419103232}'),
}
REPORT, MANIFEST = ("report",), "manifest.json"
OPENS_RUN = "report", "gate", "validate", "view", "render", "program", "timing", "sweep"
SUMMARY, ARRAYS, SEARCH = "summary.json", "trajectory.npz", "place.json"
OPENS_PLAN = "validate", "view", "render", "program"
READS_SHARD = "report", "gate", "validate", "view", "render", "program"
KINDS: dict[str, Kind] = {
    **{f"manifest {name}": Kind("run", replaced(MANIFEST, make), OPENS_RUN, MANIFEST) for name, make in JSONS.items()},
    **{f"reachability {n}": Kind("run", replaced(REACHABLE, make), REPORT, REACHABLE) for n, make in JSONS.items()},
    "reachability infinite prefix": Kind("run", changed(REACHABLE, "prefix", 0, to="HUGE"), REPORT, REACHABLE),
    "reachability wide seed": Kind("run", changed(REACHABLE, "seed", to="WIDE"), REPORT, REACHABLE),
    **{f"validation {n}": Kind("run", replaced(CHECKED, make), REPORT, CHECKED) for n, make in JSONS.items()},
    **{f"shard {name}": Kind("run", replaced(SHARD, make), READS_SHARD, SHARD) for name, make in ANYTHING.items()},
    **{f"times {name}": Kind("run", replaced(TIMES, make), REPORT, TIMES) for name, make in ANYTHING.items()},
    "shard of zeros": Kind("run", listed(data=bytes(64 * MIB)), READS_SHARD, SHARD),
    "shard of too many rows": Kind("run", listed(promised=5_000_000), READS_SHARD, SHARD),
    "shard of long words": Kind("run", long_words, READS_SHARD, SHARD),
    "shard folder elsewhere": Kind("run", linked_folder("targets"), (*READS_SHARD, "sweep"), "targets"),
    "times elsewhere": Kind("run", linked_folder("timing"), ("timing",), "timing"),
    "lock is a link": Kind("run", lambda folder, outside: link_lock(folder, outside), ("timing", "sweep"), ".lock"),
    "lock is a pipe": Kind("run", replaced(".lock", lambda file, _: os.mkfifo(file)), ("timing", "sweep"), ".lock"),
    "part is a link": Kind("run", lambda folder, outside: link_parts(folder, outside), (), ""),
    "manifest of another run": Kind("run", of_another_run, READS_SHARD, "baseline-000000"),
    "file is a device": Kind("run", device_named, OPENS_PLAN, "/dev/zero"),
    **{f"summary {name}": Kind("plan", replaced(SUMMARY, make), OPENS_PLAN, SUMMARY) for name, make in JSONS.items()},
    **{f"arrays {name}": Kind("plan", replaced(ARRAYS, make), OPENS_PLAN, ARRAYS) for name, make in ANYTHING.items()},
    "arrays bomb": Kind("plan", replaced(ARRAYS, archive(2048 * MIB)), OPENS_PLAN, ARRAYS),
    "arrays lie": Kind("plan", replaced(ARRAYS, archive(MIB, "1000000000")), OPENS_PLAN, ARRAYS),
    "plan's file is a device": Kind("plan", changed(SUMMARY, "files", to={"/dev/zero": "0"}), OPENS_PLAN, "/dev/zero"),
    "plan's file is a pipe": Kind("plan", lambda folder, outside: pipe_named(folder), OPENS_PLAN, "pipe"),
    **{f"search {name}": Kind("search", replaced(SEARCH, make), ("place",), SEARCH) for name, make in JSONS.items()},
    "rounds elsewhere": Kind("search", linked_folder("rounds"), ("place",), "rounds"),
}  # fmt: skip


def link_lock(folder: Path, outside: Path) -> None:
    (folder / ".lock").unlink(missing_ok=True)
    (outside / "own").write_text("as it was")
    (folder / ".lock").symlink_to(outside / "own")


def link_parts(folder: Path, outside: Path) -> None:
    (outside / "own").write_text("as it was")
    for name in ("manifest.json", "validation.json", "summary.json", "baseline.parquet"):
        (folder / f".part-{name}").symlink_to(outside / "own")


def pipe_named(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    changed("summary.json", "files", to={str(folder / "pipe"): "0"})(folder, folder)


def commands(kind: str, folder: Path, place: Path) -> dict[str, list[str]]:
    """Command lines that open a folder; output goes into `place`, which also has the files of run and search."""
    name, out = str(folder), place / "out"
    looks = {
        "validate": ["validate", name, "--between", "0"],
        "view": ["view", name, "--port", "0"],
        "render": ["render", name, "--movie", "none", "--width", "160", "--out", str(out / "render")],
        "program": ["program", name, "--feed", "20mm/s", "--out", str(out / "a.csv")],
    }
    return {
        "run": {
            "report": ["report", name, "--out", str(out / "report")],
            "gate": ["gate", name, "--baseline", str(place / "baseline.yaml")],
            **looks,
            "timing": ["program", name, "--all", "--feed", "20mm/s"],
            "reachability": ["reachability", str(place / "grid.yaml"), "--out", name, "--limit", "1"],
            "sweep": ["sweep", str(place / "grid.yaml"), "--methods", "baseline", "--out", name],
        },
        "plan": looks,
        "search": {"place": ["place", str(place / "place.yaml"), "--out", name]},
    }[kind]


def run(words: list[str]) -> dict:
    """Run a command; return its exit code, its stderr output, and its peak memory [bytes]."""
    from htcp_jax.cli import main

    said = io.StringIO()
    with redirect_stderr(said), redirect_stdout(io.StringIO()):
        code = main(words)
    status = Path("/proc/self/status").read_text()  # getrusage would include the parent process
    return {"code": code, "said": said.getvalue(), "peak": 1024 * int(status.partition("VmHWM:")[2].split()[0])}


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1:])))
