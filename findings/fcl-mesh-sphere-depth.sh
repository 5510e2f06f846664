#!/usr/bin/env bash
# A mesh and a sphere that overlap: FCL states penetration depths below zero
#
# Guess: a contact's penetration_depth is positive where two bodies overlap, so the largest of all contacts says how far;
# a mesh in place of a box changes little.
# Seen: python-fcl 0.7.0.11 states 60 mm for a box and a sphere. With the box as a mesh, every contact with the sphere
# has a depth from -60 mm to below 0, nearer to 0 the finer the mesh; with a capsule in place of the sphere, depths are
# positive again. A tolerance on the largest depth accepts every overlap of a mesh and a sphere.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check python-fcl==0.7.0.11 trimesh==5.2.0 numpy==2.4.6 scipy==1.17.1
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import fcl
import trimesh


def depths(one, other, z):
    request, result = fcl.CollisionRequest(num_max_contacts=10_000, enable_contact=True), fcl.CollisionResult()
    moved = fcl.CollisionObject(other, fcl.Transform([0.013, 0.007, z]))
    fcl.collide(fcl.CollisionObject(one), moved, request, result)
    found = [1e3 * contact.penetration_depth for contact in result.contacts]
    return f"{min(found):.0f} to {max(found):.0f}" if len(found) > 1 else f"{found[0]:.0f}"


print("box and sphere, 60 mm deep:", depths(fcl.Box(0.4, 0.4, 0.4), fcl.Sphere(0.1), 0.24))
for edge in (1.0, 0.1):
    solid = trimesh.creation.box((0.4, 0.4, 0.4)).subdivide_to_size(edge)
    mesh = fcl.BVHModel()
    mesh.beginModel(len(solid.vertices), len(solid.faces))
    mesh.addSubModel(solid.vertices, solid.faces)
    mesh.endModel()
    print(f"mesh of {len(solid.faces)} triangles and sphere:", depths(mesh, fcl.Sphere(0.1), 0.24))
    print(f"mesh of {len(solid.faces)} triangles and capsule:", depths(mesh, fcl.Capsule(0.05, 0.05), 0.215))
PY
diff seen.txt - <<'EXPECTED' || exit 1
box and sphere, 60 mm deep: 60
mesh of 12 triangles and sphere: -60 to -60
mesh of 12 triangles and capsule: 46 to 54
mesh of 384 triangles and sphere: -60 to -4
mesh of 384 triangles and capsule: 35 to 67
EXPECTED
cat seen.txt
echo "as seen on 2026-11-29"
