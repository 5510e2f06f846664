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
# A longer tool keeps the thick parts of the arm out of the duct; a shorter one is stiffer. How much of the weld can
# the arm follow with each length, and how does the result depend on the tilt of the duct?
#
# ## The grid
#
# A sweep plans a grid of values for keys of one job. Every combination is a scenario: nine lengths and four tilts are
# 36 scenarios of 105 targets each.

# %%
import htcp_jax

LENGTHS_M = [-0.10, -0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075, 0.10]
TILTS_RAD = [0.4, 0.5, 0.6, 0.7]

grid = {"grid": [{"workpiece.rotation_y_rad": TILTS_RAD}, {"robot.tool_extension_m": LENGTHS_M}]}
run = htcp_jax.sweep(grid, "baseline,nspace-sqp,keep-clear", "../out/tool-lengths")
run

# %% [markdown]
# The results are written to the folder. Repeat the call to read them instead of planning again. If you pass no folder,
# the results are in a temporary folder, which is deleted together with the object `run`.
#
# ## The results
#
# The table has one row per method and scenario; the varied keys are columns. Two columns count targets:
#
# - `tracked`: targets with a clear configuration whose tip is on the target;
# - `executable`: targets to which a proven motion leads from the start. Only these can be run.

# %%
scenarios = run.frame()
scenarios["failure"] = scenarios.failure.fillna("none")
columns = ["method", "rotation_y_rad", "tool_extension_m", "tracked", "executable", "failed_target", "failure"]
scenarios[columns].head(9)

# %% [markdown]
# The number of executable targets, of 105:

# %%
scenarios.pivot_table("executable", index=["method", "rotation_y_rad"], columns="tool_extension_m", aggfunc="sum")

# %% [markdown]
# The map shows the same numbers. If more targets are tracked, their number is in brackets. Bold numbers mark motions to
# the end of the weld.

# %%
htcp_jax.chart(run, "map")

# %% [markdown]
# The report's table has the rates with their 95 % confidence intervals. These hold for a random sample. The 36
# scenarios are a regular grid, for which an interval only shows that they are few.

# %%
report = htcp_jax.make_report(run)
report.frame("scenario-rates").round(1)

# %% [markdown]
# ## Why plans end
#
# Every incomplete plan has a failed target and a reason.

# %%
htcp_jax.chart(run, "stops")

# %%
scenarios.groupby(["method", "failure"]).size().unstack(fill_value=0)

# %% [markdown]
# ## The answer
#
# The table lists, for each method and tilt, the shortest of these tool extensions with which the arm follows the
# complete weld [m], or a dash if there is none.

# %%
whole = scenarios[scenarios.executable == scenarios.targets]
shortest = whole.pivot_table("tool_extension_m", index="method", columns="rotation_y_rad", aggfunc="min")
shortest.reindex(index=run.methods, columns=TILTS_RAD).astype(object).fillna("-")
