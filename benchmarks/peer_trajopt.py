"""TrajOpt as one of the `peers`, within the limits of the Python bindings of tesseract-robotics 0.5.1.

Every problem is built term by term, because the profile of its planner does not accept the weights of a position-only
waypoint: the setter of `cartesian_constraint_config.coeff` refuses every array. The cloud is one link of small spheres,
because `OcTree` has no constructor.
"""

import os
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.peer_planners import Advance, Task

DOT_M = 1e-4  # radius of the spheres
PLUGINS = """
contact_manager_plugins:
  search_libraries: [tesseract_collision_bullet_factories]
  discrete_plugins:
    default: Bullet
    plugins: {Bullet: {class: BulletDiscreteBVHManagerFactory, default: true}}
  continuous_plugins:
    default: Bullet
    plugins: {Bullet: {class: BulletCastBVHManagerFactory, default: true}}
"""


def trajopt(task: Task) -> Advance:
    """One problem per target, from x_{t-1}: constraints on position and clearance, and a cost on joint motion."""
    os.environ.setdefault("TRAJOPT_LOG_THRESH", "ERROR")  # unset, it prints at import how to set it
    import tesseract_robotics.tesseract_collision as collision
    import tesseract_robotics.tesseract_motion_planners_trajopt as planner

    environment, pose = _tesseract_scene(task)
    group = environment.getJointGroup("manipulator")
    names, weights = list(group.getJointNames()), np.array(task.settings.q_weights)
    only_position = np.array([10.0, 10.0, 10.0, 0.0, 0.0, 0.0])
    clear = planner.createCollisionTermInfo(
        0, 0, task.margin - DOT_M, 0.02, planner.CollisionEvaluatorType_SINGLE_TIMESTEP, False, 1.0,
        collision.ContactTestType_CLOSEST, 0.005, planner.TermType_TT_CNT,
    )  # fmt: skip
    # OptimizeProblem of this module always passes a plotter, 0, which the wrapped function refuses.
    wrapper = planner.tesseract_motion_planners_trajopt_python
    optimise = wrapper._tesseract_motion_planners_trajopt_python.OptimizeProblem

    def advance(x: np.ndarray, target: np.ndarray) -> np.ndarray:
        problem = planner.ProblemConstructionInfo(environment)
        problem.basic_info.n_steps, problem.basic_info.manip, problem.basic_info.use_time = 1, "manipulator", False
        problem.kin = group
        problem.init_info.type, problem.init_info.data = planner.InitInfo.GIVEN_TRAJ, x[None].copy()
        here = "world", pose(target), "tool", pose(np.zeros(3)), only_position
        problem.cnt_infos.append(planner.createCartesianWaypointTermInfo(0, *here, planner.TermType_TT_CNT))
        problem.cnt_infos.append(clear)
        near = planner.createNearJointStateTermInfo(x, names, 0, weights, planner.TermType_TT_COST)
        problem.cost_infos.append(near)
        found = np.array(optimise(planner.ConstructProblem(problem)).traj)[0]
        return np.clip(found, task.lower, task.upper)

    return advance


def _tesseract_scene(task: Task) -> tuple:
    """Build the arm and the cloud in tesseract, and a function from position and quaternion to its pose.

    Every capsule is a link, so that each has a nearest point.
    """
    import tesseract_robotics.tesseract_common as common
    import tesseract_robotics.tesseract_environment as environment
    import tesseract_robotics.tesseract_geometry as geometry
    import tesseract_robotics.tesseract_scene_graph as scene
    import tesseract_robotics.tesseract_srdf as srdf

    def pose(position: np.ndarray, quaternion: np.ndarray | None = None):
        T, rotation = np.eye(4), np.empty(9)
        if quaternion is not None:
            mujoco.mju_quat2Mat(rotation, quaternion)
            T[:3, :3] = rotation.reshape(3, 3)
        T[:3, 3] = position
        return common.Isometry3d(T)

    graph, model = scene.SceneGraph(), task.model
    graph.setName("arm")
    graph.addLink(scene.Link("world"))

    def hang(link, parent: str, where, turns: bool = False) -> str:
        joint = scene.Joint(f"to {link.getName()}")
        joint.parent_link_name, joint.child_link_name = parent, link.getName()
        joint.parent_to_joint_origin_transform = where
        joint.type = scene.JointType_REVOLUTE if turns else scene.JointType_FIXED
        if turns:
            limits, joint.axis = scene.JointLimits(), np.array([0.0, 0.0, 1.0])
            limits.lower, limits.upper, limits.velocity, limits.acceleration = -np.pi, np.pi, 3.0, 3.0
            joint.limits = limits
        graph.addLink(link)
        graph.addJoint(joint)
        return link.getName()

    def shape(link, form, where) -> None:
        one = scene.Collision()
        one.geometry, one.origin = form, where
        link.collision.append(one)

    for b in range(1, model.nbody):
        where = pose(model.body_pos[b], model.body_quat[b])
        parent = model.body(model.body_parentid[b]).name
        hang(scene.Link(model.body(b).name), parent, where, bool(model.body_jntnum[b]))
    capsules = []
    for k, (radius, half) in enumerate(zip(task.radius, task.half, strict=True)):
        link = scene.Link(model.geom(k).name)
        shape(link, geometry.Capsule(radius, 2 * half) if half else geometry.Sphere(radius), pose(np.zeros(3)))
        where = pose(model.geom_pos[k], model.geom_quat[k])
        capsules.append(hang(link, model.body(model.geom_bodyid[k]).name, where))
    cloud, dot = scene.Link("cloud"), geometry.Sphere(DOT_M)
    for point in task.cloud @ task.rotate.T + task.translate:
        shape(cloud, dot, pose(point))
    hang(cloud, "world", pose(np.zeros(3)))
    apart = "".join(
        f'<disable_collisions link1="{a}" link2="{b}" reason="Never"/>' for a in capsules for b in capsules if a < b
    )
    with tempfile.TemporaryDirectory() as folder:
        plugins = Path(folder) / "plugins.yaml"
        plugins.write_text(PLUGINS)
        text = (
            f'<robot name="arm"><group name="manipulator"><chain base_link="world" tip_link="tool"/></group>{apart}'
            f'<contact_managers_plugin_config filename="{plugins.as_uri()}"/></robot>'
        )
        meaning, made = srdf.SRDFModel(), environment.Environment()
        meaning.initString(graph, text, common.GeneralResourceLocator())
        made.init(graph, meaning)
    made.setState(list(made.getJointGroup("manipulator").getJointNames()), task.start)
    return made, pose
