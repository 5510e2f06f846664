# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Where to mount a part
#
# A part has several seams. Where must it be mounted, and how long must the tool be, so that the arm can follow all of
# them in one mounting with the largest clearance? `htcp_jax.place` searches for such a mounting; see `docs/place.md`.
#
# `configs/place/seams.yaml` is such a search for the six seams of the generated duct in `configs/six-seams.yaml`:

# %%
from pathlib import Path

import pandas

import htcp_jax
from htcp_jax.report import best_pictures, read_search

FILE = Path("../configs/place/seams.yaml")
print(FILE.read_text())

# %% [markdown]
# ## All six seams
#
# A scenario is one mounting with one seam. The file sets a budget of 20,004 scenarios; here 300 are enough to show
# which seams few mountings complete.

# %%
first = htcp_jax.place(FILE, "../out/six-seams", changes={"within": {"scenarios": 300}, "best": 1})
pandas.DataFrame(first.seams(), index=["complete in mountings", "share in the best mounting"]).T

# %% [markdown]
# ## Two of the seams
#
# Now search for one mounting that completes two of the easier seams. To save time, proven motions are planned only for
# the best mounting instead of the default 20. Repeat the call to read the results from the folder.

# %%
two = "seams=[{name: right, path: right}, {name: invert, path: invert}]"
changes = {"within": {"scenarios": 240}, "best": 1}
found = htcp_jax.place(FILE, "../out/two-seams", overrides=[two], changes=changes)
print(f"{found.complete} mountings track both seams; {len(found.mountings)} was confirmed by proven motions")

# %% [markdown]
# The ranking lists the guaranteed clearance along both motions; its minimum if every parameter is perturbed by up to
# 3 mm and 0.5 degrees; and the largest tested perturbation of all parameters at once that loses no target.

# %%
searched = read_search("../out/two-seams")
table = pandas.DataFrame(searched.ranked, columns=[one.label for one in searched.parameters])
table["clearance [mm]"] = searched.objective[:, 0]
table["when perturbed [mm]"] = searched.worst[:, 0]
perturbation = found.search.file.perturbation
table["tolerates [mm]"] = [one.tolerance and perturbation.mm * one.tolerance.together for one in found.mountings]
table["tolerates [°]"] = [one.tolerance and perturbation.deg * one.tolerance.together for one in found.mountings]
table.index = pandas.RangeIndex(1, len(table) + 1, name="rank")
table.round(2)

# %% [markdown]
# ## The map
#
# Each panel shows all mountings over two of the parameters: complete ones, nearly complete ones, and for all others the
# reason why they fail.

# %%
htcp_jax.charts.place_map(searched)

# %% [markdown]
# ## The best mounting
#
# The picture shows the arm in the best mounting, at the seam with the smaller guaranteed clearance.

# %%
best_pictures(Path("../out/two-seams"), searched)[1]
