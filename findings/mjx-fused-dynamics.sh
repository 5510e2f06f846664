#!/usr/bin/env bash
# Inverse dynamics of MJX on a CPU: 100 times as slow, or slower, where XLA fuses the chain of links
#
# Guess: a batch of inverse dynamics that jax.jit compiles is about as fast with one pass of the compiler as without.
# Seen: 1,024 configurations of an arm with seven joints, mujoco-mjx 3.17.0 and jax 0.10.2: seconds by default,
# milliseconds with the compiler option xla_disable_hlo_passes=fusion, the same torques. The fused code computes a
# link's pose again for each value that depends on it. With jax 0.11.2 (Python 3.12) both take milliseconds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 mujoco==4.0.0 mujoco-mjx==3.17.0 numpy==2.4.6
JAX_PLATFORMS=cpu venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import time
from functools import partial

import jax
import mujoco
import numpy as np
from mujoco import mjx

jax.config.update("jax_enable_x64", True)
body = ""
for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 0 1")):
    body += f'<body pos="0 0 .2"><inertial pos="0 0 .1" mass="{5 - k / 2}" diaginertia=".1 .1 .05"/><joint axis="{axis}"/>'
model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}{'</body>' * 7}</worldbody></mujoco>")
device = mjx.put_model(model)
blank = mjx.make_data(device)
x, v, a = np.random.default_rng(0).normal(size=(3, 1024, 7))


def torque(x, v, a):
    data = mjx.com_vel(device, mjx.com_pos(device, mjx.kinematics(device, blank.replace(qpos=x, qvel=v, qacc=a))))
    return mjx.rne(device, data, flg_acc=True).qfrc_bias


took, found = {}, {}
for name, options in (("by default", {}), ("without fusion", {"xla_disable_hlo_passes": "fusion"})):
    run = jax.jit(jax.vmap(torque), compiler_options=options)
    np.asarray(run(x, v, a))  # compiles
    began = time.perf_counter()
    found[name] = np.asarray(run(x, v, a))
    took[name] = time.perf_counter() - began
    print(f"{name}: {took[name]:.3f} s")
data, most = mujoco.MjData(model), 0.0
for k in range(1024):
    data.qpos[:], data.qvel[:], data.qacc[:] = x[k], v[k], a[k]
    mujoco.mj_inverse(model, data)
    most = max(most, *(np.abs(each[k] - data.qfrc_inverse).max() for each in found.values()))
print(f"largest difference from MuJoCo: {'below' if most < 1e-9 else 'above'} 1e-9 N m")
print("100 times or more" if took["by default"] > 100 * took["without fusion"] else "less than 100 times")
PY
cat seen.txt
grep -q "^100 times or more" seen.txt && grep -q "below 1e-9" seen.txt
