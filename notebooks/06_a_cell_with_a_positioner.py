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
# # A cell with a positioner
#
# A GP50 welds a branch to a pipe, which is mounted on a positioner with two axes. The torch must point into the corner
# within 20 degrees, and the seam's normal must point up within 15 degrees (flat position). One plan moves all eight
# joints.
# The tutorial in `docs/positioner.md` does the same by commands.

# %%
from pathlib import Path

import numpy as np
import pandas
from matplotlib.figure import Figure

import htcp_jax

JOB = Path("../configs/positioner/job.yaml")
print(JOB.read_text())

# %% [markdown]
# ## The plan
#
# Joints are in the order from the part to the torch: the positioner's `turn` and `tilt`, then the arm's six.

# %%
plan = htcp_jax.plan(JOB)
plan

# %% [markdown]
# The first view shows the cell in the world, where the part moves; the second shows it from the part, where the torch
# moves around the branch.

# %%
plan.figure()

# %% [markdown]
# ## How far do the positioner and the arm move?
#
# The table lists the smallest and largest position of each joint along the path, in degrees. The positioner's table
# turns, and the arm hardly moves.

# %%
frame = plan.frame()
joints = np.degrees(frame[[f"{name}_rad" for name in plan.robot.joint_names]]).set_axis(plan.robot.joint_names, axis=1)
joints.agg(["min", "max"]).T.assign(travel=lambda each: each["max"] - each["min"]).round(1)

# %% [markdown]
# ## Is the seam flat?
#
# The plot shows the angle between the seam's normal and the vertical. It depends only on the positioner's two angles:
# the faceplate turns about z, then tilts about y. Target 0 is the start; the other targets are the rows of the seam's
# file.

# %%
normals = pandas.read_csv(JOB.parent / "seam.csv")[["nx", "ny", "nz"]].to_numpy()


def off_vertical_deg(normal, turn, tilt):
    """Return the angle between a normal on the faceplate and the vertical."""
    x = np.cos(turn) * normal[:, 0] - np.sin(turn) * normal[:, 1]
    return np.degrees(np.arccos(np.cos(tilt) * normal[:, 2] - np.sin(tilt) * x))


turn, tilt = frame.turn_rad.to_numpy()[1:], frame.tilt_rad.to_numpy()[1:]
flat_deg = off_vertical_deg(normals, turn, tilt)
print(f"at most {flat_deg.max():.2f} degrees from the vertical; 15 are allowed")

# %%
figure = Figure(figsize=(9, 5), dpi=100, layout="constrained")
angles, flat = figure.subplots(2, sharex=True)
for name, values, colour in (("turn", turn, "#0072b2"), ("tilt", tilt, "#d55e00")):
    angles.plot(frame.target[1:], np.degrees(values), color=colour, linewidth=2, label=name)
angles.set(ylabel="position [°]", title="the positioner along the seam")
angles.legend(frameon=False)
flat.plot(frame.target[1:], flat_deg, color="#0072b2", linewidth=2)
flat.axhline(15, color="#3b4650", linestyle="--", linewidth=1)
flat.set(xlabel="target", ylabel="from the vertical [°]", ylim=(0, 16))
for axes in (angles, flat):
    axes.spines[["top", "right"]].set_visible(False)
figure

# %% [markdown]
# ## Without the positioner
#
# If both axes are locked, no joint changes the direction of the seam's normal, and the job is refused before planning:

# %%
try:
    htcp_jax.plan(JOB, {"robot.locked": {"tilt": -0.8, "turn": 0.0}})
except htcp_jax.InputError as refused:
    print(refused)

# %% [markdown]
# ## With one axis
#
# If the tilt is locked, a turn of the table cannot make every normal vertical. The angle that remains is the difference
# between the tilt and the normal's angle from the table's axis. So the tilt must be within 15 degrees of the angles of
# all normals:

# %%
from_axis_deg = np.degrees(np.arccos(normals[:, 2]))
tilts_rad = np.array([-1.0, -0.9, -0.8, -0.7])
worst_deg = np.abs(np.degrees(-tilts_rad)[:, None] - from_axis_deg).max(axis=1)
pandas.DataFrame({"locked tilt [rad]": tilts_rad, "from the vertical, at the worst point [°]": worst_deg.round(1)})
