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
# # A sweep in Parquet: DuckDB and Polars
#
# A sweep writes Parquet files, which many tools read without `htcp_jax`. This notebook queries a sweep of twelve poses
# by SQL in DuckDB and by lazy frames in Polars, and draws the results.

# %%
import json

import duckdb
import polars
import pyarrow.parquet
from matplotlib.figure import Figure

import htcp_jax

OUT = "../out/twelve-poses"
TILTS_RAD, TURNS_RAD = [0.3, 0.4, 0.5, 0.6], [-0.2, 0.0, 0.2]
grid = {"grid": [{"workpiece.rotation_y_rad": TILTS_RAD}, {"workpiece.rotation_z_rad": TURNS_RAD}]}
run = htcp_jax.sweep(grid, "nspace-sqp,beam", OUT)
run

# %% [markdown]
# ## The files
#
# `targets/` has one row per method, scenario and target, `scenarios/` one row per method and scenario.

# %%
polars.Config(tbl_rows=-1, fmt_str_lengths=100)
duckdb.sql(f"SELECT file_name, num_rows FROM parquet_file_metadata('{OUT}/*/*.parquet')").pl()

# %% [markdown]
# The files contain the unit and the description of each column, and the versions of the packages that wrote them. These
# are the columns of `targets/`:

# %%
schema = pyarrow.parquet.read_schema(next(run.folder.glob("targets/*.parquet")))
about = [{key.decode(): text.decode() for key, text in (field.metadata or {}).items()} for field in schema]
polars.DataFrame(
    {
        "column": schema.names,
        "unit": [each.get("unit") for each in about],
        "description": [each.get("description") for each in about],
    }
)

# %%
json.loads(schema.metadata[b"htcp_jax"])["versions"]

# %% [markdown]
# ## SQL: how many targets does each method execute?
#
# A target is *executable* if a proven motion leads from the start to this target.

# %%
duckdb.sql(f"""
    SELECT method, count(*) AS scenarios, sum(targets)::INT AS targets, sum(tracked)::INT AS tracked,
           sum(executable)::INT AS executable,
           count(*) FILTER (executable = targets) AS executable_to_the_last_target
    FROM '{OUT}/scenarios/*.parquet' GROUP BY method ORDER BY method
""").pl()

# %% [markdown]
# A join of both tables returns, for each scenario, the first target that is not executable and the reason. Either the
# target is not tracked (`status`), or the segment to it is not valid (`segment_status`).

# %%
duckdb.sql(f"""
    SELECT method, status, segment_status, count(*) AS scenarios, min(target) AS first, max(target) AS last
    FROM '{OUT}/scenarios/*.parquet' JOIN '{OUT}/targets/*.parquet' USING (method, scenario)
    WHERE target = executable GROUP BY ALL ORDER BY ALL
""").pl()

# %% [markdown]
# ## Polars: the clearance along the path
#
# A lazy query reads only the columns that it names. This query returns, per method and target, the number of scenarios
# that track the target, and the minimum, median and maximum of their clearances.

# %%
clearance_mm = 1e3 * polars.col("clearance_m")
along = (
    polars.scan_parquet(f"{OUT}/targets/*.parquet")
    .filter(polars.col("tracked"))
    .group_by("method", "target")
    .agg(
        polars.len().alias("scenarios"),
        clearance_mm.min().alias("min_mm"),
        clearance_mm.median().alias("median_mm"),
        clearance_mm.max().alias("max_mm"),
    )
    .sort("method", "target")
    .collect()
)
along.gather_every(15)

# %%
figure = Figure(figsize=(9, 5.2), dpi=100, layout="constrained")
clearance, tracked = figure.subplots(2, sharex=True, height_ratios=(2, 1))
for method, colour in zip(run.methods, ("#0072b2", "#d55e00"), strict=True):
    rows = along.filter(polars.col("method") == method)
    clearance.fill_between(rows["target"], rows["min_mm"], rows["max_mm"], color=colour, alpha=0.15, linewidth=0)
    clearance.plot(rows["target"], rows["median_mm"], color=colour, linewidth=2, label=method)
    tracked.step(rows["target"], rows["scenarios"], where="mid", color=colour, linewidth=2)
clearance.set(yscale="log", ylabel="clearance [mm]", title="median and range over the scenarios that track the target")
clearance.yaxis.set_major_formatter("{x:g}")
clearance.legend(frameon=False)
tracked.set(xlabel="target", ylabel="scenarios", xlim=(0, 104), ylim=(0, 1.1 * run.manifest.count))
for axes in (clearance, tracked):
    axes.spines[["top", "right"]].set_visible(False)
figure

# %% [markdown]
# ## Which joint moves most?
#
# Joints are columns, too. This query returns the travel of each joint along the path in radians, as a mean over the
# scenarios of `beam`:

# %%
joints = polars.col("^joint\\d+_rad$")
(
    polars.scan_parquet(f"{OUT}/targets/*.parquet")
    .filter(polars.col("tracked"), polars.col("method") == "beam")
    .sort("scenario", "target")
    .group_by("scenario")
    .agg(joints.diff().abs().sum())
    .select(joints.mean().round(3))
    .collect()
)
