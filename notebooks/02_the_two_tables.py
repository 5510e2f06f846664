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
# *Hybrid Task Constrained Planner for Robot Manipulator in Confined Environment* (Sun, Zhao, Liu) compares planners in
# two sweeps: 125 start configurations with one pose of the workpiece, and 49 poses of the workpiece with one start.
# The first target that is not tracked ends a scenario, and all later targets count as missed.
#
# The paper's measured duct is not part of this package. These plans use the generated duct, which is slightly wider;
# `docs/reproduction.md` lists the results for the measured duct.

# %%
import pandas

import htcp_jax
from htcp_jax.report import paper

# %% [markdown]
# ## Plan
#
# `configs/paper.yaml` contains the paper's choices. Repeat the call to resume a stopped run or to read a complete one.
# Two methods keep this notebook short; set `METHODS = list(paper.ROBOT.rows)` to plan with the paper's six methods, in
# some minutes.

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
# `make_report` recognises the paper's grids. Its table `paper` has the paper's values next to ours, in four columns:
# success, time per target, and TCP distance and clearance as means over the tracked targets. The paper does not define
# its "safe distance"; here it is the clearance $D$. Times are not comparable, because the paper's are from MATLAB
# on a Core i9.

# %%
COLUMNS = {
    "tracked_percent": "success [%]",
    "paper_tracked_percent": "paper [%]",
    "step_ms": "time/target [ms]",
    "paper_step_ms": "paper [ms]",
    "tcp_distance_mean_mm": "TCP distance [mean mm]",
    "paper_tcp_distance_mm": "paper [mm]",
    "clearance_mean_mm": "clearance [mean mm]",
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
# All values that the paper prints:

# %%
stated = {
    f"table {t.number}: {t.scenarios} scenarios": pandas.DataFrame(t.rows, index=paper.PaperRow._fields).T
    for t in (paper.ROBOT, paper.WORKPIECE)
}
pandas.concat(stated)

# %% [markdown]
# ## Where the methods differ
#
# The map shows for each pose after how many targets the plan ends.

# %%
report = htcp_jax.make_report(workpiece)
report.figures["map"]

# %%
report.figures["survival"]  # scenarios that have not failed before each target

# %% [markdown]
# The table lists the reasons for failure. With the paper's choices the baseline ends at its iteration limit, not with
# an infeasible QP: with margin 0 the iterates converge to $D = 0$ from $D < 0$, that is, while still in collision.

# %%
report.figures["stops"]
