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
# # The scene and one plan
#
# An arm with six joints carries a grinder into a duct, and the tip of the tool must follow the weld inside. The tip's
# position takes three of the six degrees of freedom; the other three are used to keep the arm off the wall.

# %%
from matplotlib.figure import Figure

import htcp_jax

# %% [markdown]
# ## The arm
#
# The arm is a Yaskawa GP50, modelled by eight capsules. A capsule is the set of all points within a radius of a line
# segment. The last three capsules are the tool; the last one ends before the tip, so that the tip may touch the weld.

# %%
htcp_jax.gp50()

# %% [markdown]
# ## The workpiece
#
# The workpiece is a duct of about one metre, round at the inlet and flat at the outlet, as a point cloud. The weld runs
# along one side. This duct is generated; call `htcp_jax.load_workpiece("scan.ply", "weld.csv")` to load your own scan
# and path.

# %%
htcp_jax.load_workpiece()

# %% [markdown]
# ## A plan
#
# One call plans a motion through 105 targets: the start, five steps to the inlet, five more to the weld, and the points
# of the weld. The default method is a beam search: for each target it keeps several collision-free configurations, each
# connected to the start by a proven motion. The best motion is then smoothed.

# %%
plan = htcp_jax.plan()
plan

# %%
plan.figure()

# %% [markdown]
# The plan as a table with one row per target; every 13th row is shown.

# %%
frame = plan.frame()
frame[["status", "clearance_m", "residual_m", "iterations", "joint_step_rad", "path_clear"]].iloc[::13]

# %% [markdown]
# ## Another pose, another tool
#
# `overrides` changes keys of the job, named as in a job file. If the duct is tilted further, the default tool does not
# reach the end of the weld; a tool that is 50 mm longer reaches more targets.

# %%
tilted = htcp_jax.plan(overrides={"workpiece.rotation_y_rad": 0.6})
longer = htcp_jax.plan(overrides={"workpiece.rotation_y_rad": 0.6, "robot.tool_extension_m": 0.05})
{"as it is": tilted.facts()["can be run"], "50 mm longer": longer.facts()["can be run"]}

# %%
tilted

# %% [markdown]
# The clearance of both plans along the path. A line ends where no collision-free configuration was found.


# %%
def clearance_along(**plans):
    figure = Figure(figsize=(9, 3.4), dpi=120, layout="constrained")
    axes = figure.subplots()
    for (name, one), colour in zip(plans.items(), ("#0072b2", "#d55e00"), strict=True):
        frame = one.frame()
        axes.plot(frame.target, 1e3 * frame.clearance_m, color=colour, linewidth=2, label=name.replace("_", " "))
    axes.set(yscale="log", xlabel="target", ylabel="clearance [mm]", xlim=(0, 105))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.grid(axis="y", color="#dfe3e6")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    return figure


clearance_along(as_it_is=tilted, longer_by_50_mm=longer)
