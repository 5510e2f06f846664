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
# # A study of your own: how long should the tool be?
#
# A longer tool keeps the thick parts of the arm out of the duct; a shorter one is stiffer. How much of the weld can be
# tracked with which length, and how does that depend on how the duct is tilted? This notebook answers it from start to
# end in less than two minutes on two cores.
#
# ## The grid
#
# A sweep is a grid of parameters around one configuration. Axes multiply: nine lengths by four tilts are 36 scenarios
# of 105 targets each.

# %%
import htcp_jax

LENGTHS_M = [-0.10, -0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075, 0.10]
TILTS_RAD = [0.4, 0.5, 0.6, 0.7]

grid = {"grid": [{"workpiece.rotation_y_rad": TILTS_RAD}, {"robot.tool_extension_m": LENGTHS_M}]}
run = htcp_jax.sweep(grid, methods="baseline,nspace-sqp,keep-clear")
run

# %% [markdown]
# Without a folder to write into, the results live as long as `run` does. With `out="out/tools"` they stay, and the
# same call reads them instead of planning again.
#
# ## What came out
#
# One row a method and scenario. The parameters are columns, so pandas does the rest.

# %%
scenarios = run.frame()
scenarios[["method", "rotation_y_rad", "tool_extension_m", "tracked", "failed_target", "failure"]].head(9)

# %%
scenarios.pivot_table("tracked", index=["method", "rotation_y_rad"], columns="tool_extension_m", aggfunc="sum")

# %% [markdown]
# As a map: tilt down, length across, the number of tracked targets in the cells. A bold number is a complete plan.

# %%
charts = htcp_jax.charts
tracked = {
    method: rows.pivot(index="rotation_y_rad", columns="tool_extension_m", values="tracked").to_numpy(float)
    for method, rows in scenarios.groupby("method", sort=False)
}
charts.success_map(
    tracked,
    charts.Axis("tilt [rad]", TILTS_RAD),
    charts.Axis("tool extension [mm]", [1e3 * length for length in LENGTHS_M]),
    targets=105,
    title="Tracked targets by tool length and tilt",
)

# %% [markdown]
# ## What limits it
#
# Every failure has a reason and a place. With the longer tools the scenarios end later, or not at all.

# %%
status = {method: run.plans(method).status for method in run.methods}
charts.stops(status)

# %%
scenarios.groupby(["method", "failure"], dropna=False).size().unstack(fill_value=0)

# %% [markdown]
# ## The answer
#
# The shortest tool, of those tried, with which the whole weld is tracked. A tilt that is not in the table asks for more
# than 100 mm.

# %%
complete = scenarios[scenarios.complete]
complete.groupby(["method", "rotation_y_rad"], sort=False).tool_extension_m.min().unstack()
