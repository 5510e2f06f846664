"""Normal glyphs of a path: drawn where the task names the normals, from the points into free space, in all pictures."""

import made_once
import numpy as np
import pytest
from scipy.spatial import cKDTree

from htcp_jax.spec import AxisRow, PointRow
from htcp_jax.viewer import glyphs
from htcp_jax.viewer.normal_glyphs import LENGTH_M

ON_PATH = PointRow(point="tcp", on="path")
T = np.asarray(made_once.duct().T_world(0.4, 0.1))


@pytest.mark.parametrize(
    "row",
    [
        AxisRow(axis="tcp.z", towards="-path.normal", cone_deg=30.0),
        AxisRow(axis="tcp.z", towards="path.normal"),
        PointRow(point="tcp", on="path", axes="yz", frame="path"),
    ],
)
def test_a_glyph_stands_on_every_point_of_the_path_and_leads_away_from_the_wall(row):
    duct = made_once.duct()
    found = glyphs([ON_PATH, row], duct, T)
    np.testing.assert_allclose(found[:, 0], duct.path @ T[:3, :3].T + T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found[:, 1] - found[:, 0], axis=1), LENGTH_M, atol=1e-12)
    wall = cKDTree(duct.cloud @ T[:3, :3].T + T[:3, 3])
    assert (wall.query(found[:, 1])[0] > wall.query(found[:, 0])[0] + 0.5 * LENGTH_M).mean() > 0.9


def test_there_are_none_where_no_row_names_the_normals():
    rows = [ON_PATH, AxisRow(axis="tcp.x", towards="path.tangent"), PointRow(point="link4", on=(1.0, 0.0, 1.0))]
    assert glyphs(rows, made_once.duct(), T).shape == glyphs([], made_once.duct(), T).shape == (0, 2, 3)
