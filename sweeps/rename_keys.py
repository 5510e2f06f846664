"""Give the keys that were renamed their new names in baselines, and in folders of runs and of plans.

    .venv/bin/python sweeps/rename_keys.py sweeps/baselines/workpiece.yaml out/workpiece out/plan

Nothing but names changes, and the hash over them; a run can then be continued, and held to its baseline. Files are
written aside and renamed.
"""

import json
import re
import sys
from pathlib import Path

import yaml

from htcp_jax.jobs.config import RENAMED_WORKPIECE
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.plan_folder import SUMMARY, write_text
from htcp_jax.settings import RENAMED

SECTIONS = {"settings": RENAMED, "workpiece": RENAMED_WORKPIECE}


def rename(place: Path) -> bool:
    """Rewrite a baseline, or the file of a run or of a plan that holds its configuration; whether anything changed."""
    if place.is_dir():
        place = place / (MANIFEST if (place / MANIFEST).exists() else SUMMARY)
    text = place.read_text(encoding="utf-8")
    new = _renamed_yaml(text) if place.suffix == ".yaml" else _renamed_json(text)
    if new != text:
        write_text(place, new)
    return new != text


def _renamed_yaml(text: str) -> str:
    """A baseline, line by line, so that its layout stays."""
    for old, new in {**RENAMED, **RENAMED_WORKPIECE}.items():
        text = re.sub(rf"^( +){old}:", rf"\1{new}:", text, flags=re.MULTILINE)
    text = re.sub("^ceiling:", "reachability:", text, flags=re.MULTILINE)
    found = yaml.safe_load(text)
    return text.replace(found["config_hash"], config_hash(found["planned"]))


def _renamed_json(text: str) -> str:
    known = json.loads(text)
    before = json.dumps(known)
    varied = {key for group in known.get("grid", ()) for axis in group["axes"] for key in axis}
    for section, names in SECTIONS.items():
        values = known["config"][section]
        known["config"][section] = {names.get(name, name): value for name, value in values.items()}
    if lost := sorted(varied & {f"{section}.{name}" for section, names in SECTIONS.items() for name in names}):
        raise SystemExit(f"a run over {lost[0]} has a column of that name; plan it again")
    if json.dumps(known) == before:
        return text
    if "config_hash" in known:
        same = identity(known["config"], known["grid"], known["dtype"], known["files"])
        known["config_hash"] = config_hash(same)
    return json.dumps(known, indent=2) + "\n"


if __name__ == "__main__":
    if not sys.argv[1:]:
        raise SystemExit(__doc__)
    for word in sys.argv[1:]:
        print(f"{word}: {'renamed' if rename(Path(word)) else 'nothing to rename'}")
