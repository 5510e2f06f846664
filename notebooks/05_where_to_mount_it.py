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
# # Where to mount it
#
# A part has several seams. How must it be mounted, and how long must the tool be, so that the arm can follow all of
# them in one mounting, with the largest safety margin? `htcp_jax.place` searches for it; see `docs/place.md`.
#
# `configs/place/seams.yaml` asks it for six seams of the generated duct.

# %%
from pathlib import Path

import pandas

import htcp_jax
from htcp_jax.report.charts.placement import place_map
from htcp_jax.report.place_pictures import best_pictures
from htcp_jax.report.place_tables import read_search

FILE = Path("../configs/place/seams.yaml")
print(FILE.read_text())

# %% [markdown]
# ## All six, a first look
#
# A scenario is one mounting with one seam. The file asks for 20,004 of them; 300 show which seams are hard.

# %%
first = htcp_jax.place(FILE, "../out/six-seams", changes={"within": {"scenarios": 300}, "best": 1})
pandas.DataFrame(first.seams(), index=["complete in mountings", "share in the best mounting"]).T

# %% [markdown]
# ## Two of them
#
# The seams that many mountings do, in one mounting. Only the best is confirmed as motions here, for time; the file's
# default is 20. The same call again reads what is in the folder.

# %%
changes = {"seams": ["right", "invert"], "within": {"scenarios": 240}, "best": 1}
found = htcp_jax.place(FILE, "../out/two-seams", changes=changes)
print(
    f"{found.complete} of the mountings that were evaluated do both, {len(found.mountings)} were confirmed as motions"
)

# %% [markdown]
# The ranked ones: the clearance that is proven all along both motions, the least of it while every parameter is off by
# up to 3 mm and 0.5 degrees, and by how much all may be off before something is lost.

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
# Each panel shows all mountings in two of the parameters: where everything works, where it nearly does, and what blocks
# elsewhere.

# %%
place_map(searched)

# %% [markdown]
# ## The best of them
#
# At the seam with the least guaranteed clearance.

# %%
best_pictures(Path("../out/two-seams"), searched)[1]
