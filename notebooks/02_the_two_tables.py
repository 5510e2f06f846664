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
# # The two tables of the paper
#
# *Hybrid Task Constrained Planner for Robot Manipulator in Confined Environment* (Sun, Zhao, Liu) judges its planners
# by two sweeps: 125 start configurations in front of one workpiece, and 49 poses of the workpiece in front of one
# start. A target that stays out of reach ends its scenario, and all later targets count as missed.
#
# The measured duct of the paper is not part of this package. What follows is planned on the generated one, which is a
# little roomier; `docs/reproduction.md` has the figures of the measured one.

# %%
import pandas

import htcp_jax
from htcp_jax.report import paper

# %% [markdown]
# ## Plan, or read what is planned
#
# `configs/paper.yaml` holds the paper's choices. The same call continues a run that was stopped, and reads one that is
# complete. Two methods keep this notebook short; for all six of the paper, `METHODS = list(paper.ROBOT.rows)`, it
# takes some minutes more.

# %%
METHODS = ["baseline", "nspace-sqp"]


def swept(name):
    return htcp_jax.sweep(f"../sweeps/{name}.yaml", METHODS, f"../out/{name}-paper", config="../configs/paper.yaml")


robot, workpiece = swept("robot"), swept("workpiece")

# %%
robot

# %%
workpiece

# %% [markdown]
# ## The tables, next to the paper's
#
# `make_report` recognises the paper's grids. Its table `paper` has the paper's four columns next to ours: success, time
# per step, TCP distance (mean over the tracked targets) and safe distance (here the mean of $D$ over the tracked
# targets; the paper does not define it). Times are not comparable: the paper's are from MATLAB on a Core i9.

# %%
COLUMNS = {
    "success_percent": "success [%]",
    "paper_success_percent": "paper [%]",
    "step_ms": "time per step [ms]",
    "paper_step_ms": "paper [ms]",
    "tcp_distance_mean_mm": "TCP distance [mm]",
    "paper_tcp_distance_mm": "paper [mm]",
    "clearance_mean_mm": "safe distance [mm]",
    "paper_safe_distance_mm": "paper [mm]",
}


def table(run):
    found = htcp_jax.make_report(run).frame("paper").set_index("method")
    return found[list(COLUMNS)].rename(columns=COLUMNS).round(4)


# %% [markdown]
# ### Table 1: 125 start configurations

# %%
table(robot)

# %% [markdown]
# ### Table 2: 49 poses of the workpiece

# %%
table(workpiece)

# %% [markdown]
# All that the paper states, for reference.

# %%
stated = {
    f"table {t.number}: {t.scenarios} scenarios": pandas.DataFrame(t.rows, index=paper.PaperRow._fields).T
    for t in (paper.ROBOT, paper.WORKPIECE)
}
pandas.concat(stated)

# %% [markdown]
# ## Where the difference is made
#
# The middle of the table hides what the map shows: which poses are lost, and how late.

# %%
report = htcp_jax.make_report(workpiece)
report.figures["map"]

# %%
report.figures["survival"]

# %% [markdown]
# And why they end. With the paper's choices, a baseline is not stopped by an infeasible QP but by its iteration limit:
# with margin 0 the iterates converge onto $D = 0$ from the wrong side.

# %%
report.figures["stops"]
