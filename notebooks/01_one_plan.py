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
# A six-joint arm carries a grinder into a duct, and the tip of the tool must follow the weld inside. The position of
# the tip takes three of the arm's six degrees of freedom. The other three are free, and they are what keeps the rest
# of the arm off the wall.

# %%
from matplotlib.figure import Figure

import htcp_jax

# %% [markdown]
# ## The arm
#
# A Yaskawa GP50, as eight capsules: a capsule is all points nearer to a line segment than its radius. The last three
# are the tool. The last one stops short of the tip, so that the tip may touch the weld.

# %%
htcp_jax.gp50()

# %% [markdown]
# ## The workpiece
#
# A duct of about one metre, round at the inlet and flat at the outlet, as a cloud of points. The weld runs along one
# side. This duct is generated; a scan of your own goes the same way: `htcp_jax.load_workpiece("scan.ply", "weld.csv")`.

# %%
htcp_jax.load_workpiece()

# %% [markdown]
# ## A plan
#
# One call. It approaches the inlet in five steps, the weld in five more, and then tracks the weld: 105 targets with
# the start. For each of them it keeps a set of configurations that are clear of every point, and to which a proven
# motion leads from the start; it ends at the first target to which none leads on. The best motion through these sets is
# then made as short as it can be.

# %%
plan = htcp_jax.plan()
plan

# %%
plan.figure()

# %% [markdown]
# The same as a table, a row a target.

# %%
frame = plan.frame()
frame[["status", "clearance_m", "residual_m", "iterations", "joint_step_rad", "path_clear"]].iloc[::13]

# %% [markdown]
# ## Another pose, another tool
#
# Everything that a configuration file may say can be changed in the call, under the same name. Tilted further, the
# outlet becomes too narrow for this tool; one that is 50 mm longer gets further in.

# %%
tilted = htcp_jax.plan(overrides={"workpiece.rotation_y_rad": 0.6})
longer = htcp_jax.plan(overrides={"workpiece.rotation_y_rad": 0.6, "robot.tool_extension_m": 0.05})
{"as it is": tilted.facts()["targets tracked"], "50 mm longer": longer.facts()["targets tracked"]}

# %%
tilted

# %% [markdown]
# The clearance of both along the path. Where a line ends, no clear configuration was found.


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
