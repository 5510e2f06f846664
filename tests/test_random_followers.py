"""Random trees with random followers: the files that the import writes, beside MuJoCo with its constraints solved."""

import mujoco
import numpy as np
import pytest
from coupled import solved
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.io.robots import arm_xml, import_robot
from htcp_jax.io.robots.model_file import RobotFields, read_robot_file

TREES = 60


def words(numbers) -> str:
    return " ".join(map(str, np.ravel(numbers).tolist()))


class Tree:
    """A model of a few bodies, each with up to two joints, some of which follow others or are held."""

    def __init__(self, rng: np.random.Generator):
        count = int(rng.integers(5, 10))
        self.rng, self.joints = rng, []
        self.parents = [-1, *(int(rng.integers(max(-1, k - 3), k)) for k in range(1, count))]
        self.tip, self.part = int(rng.integers(count)), f"b{rng.integers(count)}" if rng.random() < 0.4 else None
        bodies = "".join(self._body(k) for k in range(count) if self.parents[k] < 0)
        self.followers, rows = set(), []
        order = rng.permutation(len(self.joints))
        for place, k in enumerate(order):
            name, what = self.joints[k], rng.random()
            if place and what < 0.4:
                self.followers.add(name)
                master, factor = self.joints[order[rng.integers(place)]], rng.choice([-2, -0.5, 0, 1, 1.3])
                rows.append(
                    f'<joint joint1="{name}" joint2="{master}" polycoef="{words(0.1 * rng.normal())} {factor}"/>'
                )
            elif what > 0.93:
                self.followers.add(name)
                rows.append(f'<joint joint1="{name}" polycoef="{words(0.2 * rng.normal())}"/>')
        self.text = (
            '<mujoco><compiler angle="radian" boundmass="1" boundinertia="1"/>'
            f"<worldbody>{bodies}</worldbody><equality>{''.join(rows)}</equality></mujoco>"
        )

    def _body(self, k: int) -> str:
        rng, text = self.rng, ""
        for _ in range(rng.integers(3) if k else 1):
            self.joints.append(f"j{len(self.joints)}")
            kind, ref = "slide" if rng.random() < 0.25 else "hinge", 0.3 * rng.normal() if rng.random() < 0.4 else 0.0
            at = f'axis="{words(rng.normal(size=3))}" pos="{words(0.1 * rng.normal(size=3))}" ref="{ref}"'
            text += f'<joint name="{self.joints[-1]}" type="{kind}" {at} range="-9 9"/>'
        text += f'<geom name="g{k}" size="0.01"/>' + ('<site name="tcp" pos="0.1 0 0.05"/>' if k == self.tip else "")
        text += "".join(self._body(child) for child, parent in enumerate(self.parents) if parent == k)
        pose = f'pos="{words(0.2 * rng.normal(size=3))}" euler="{words(rng.normal(size=3))}"'
        return f'<body name="b{k}" {pose}>{text}</body>'


def places(arm: RobotFields, u: np.ndarray) -> dict[str, np.ndarray]:
    """Positions of the TCP and of the capsules in the frame of the chain's root [m], in NumPy."""
    slides, axes, coupling = arm.facts["slides"], arm.arrays["axis"], arm.coupling
    q = u if coupling is None else coupling["factors"] @ u + coupling["offsets"]
    parents = range(-1, len(q) - 1) if coupling is None else coupling["parents"]
    links = [np.eye(4)]  # the root first
    for k, (slide, axis, value) in enumerate(zip(slides, axes, q, strict=True)):
        motion = np.eye(4)
        if slide:
            motion[:3, 3] = value * axis
        else:
            motion[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
        links.append(links[parents[k] + 1] @ arm.arrays["T_parent_joint"][k] @ motion)
    last = len(q) if coupling is None else coupling["tcp_link"] + 1
    found = {"tcp": links[last] @ arm.arrays["T_link_tcp"][:, 3]}
    for name, link, p in zip(
        arm.facts["capsule_names"], arm.facts["capsule_link"], arm.arrays["capsule_p"], strict=True
    ):
        found[name] = links[link + 1] @ [*p, 1.0]
    return {name: point[:3] for name, point in found.items()}


@pytest.mark.filterwarnings("ignore:.*is on a jaw")
def test_random_arms_move_as_mujoco_with_its_constraints_solved(tmp_path):
    rng, coupled, reversed_ones = np.random.default_rng(0), 0, 0
    file, out = tmp_path / "model.xml", tmp_path / "arm.xml"
    for _ in range(TREES):
        tree = Tree(rng)
        file.write_text(tree.text)
        try:
            out.write_text(arm_xml(import_robot(file, "tcp", part=tree.part, fewest=1), "model.xml"))
        except InputError as refused:
            assert "no joint" in str(refused)  # between the part's link and the TCP
            continue
        arm, model = (
            read_robot_file(out, "tcp", "model", np.eye(4), None, fewest=1),
            mujoco.MjModel.from_xml_path(str(file)),
        )
        at = {name: float(model.joint(name).qpos0[0]) for name in tree.joints if name not in tree.followers}
        u = rng.uniform(-1, 1, len(arm.facts["joint_names"]))
        data, _ = solved(model, at | dict(zip(arm.facts["joint_names"], u, strict=True)))
        root = data.body(tree.part or "world")
        for name, point in places(arm, u).items():
            there = data.site("tcp").xpos if name == "tcp" else data.geom(name).xpos
            expected = root.xmat.reshape(3, 3).T @ (there - root.xpos)
            np.testing.assert_allclose(point, expected, rtol=0, atol=1e-9, err_msg=tree.text)
        coupled += arm.coupling is not None
        reversed_ones += arm.coupling is not None and tree.part is not None
    assert coupled > 30 and reversed_ones > 8
