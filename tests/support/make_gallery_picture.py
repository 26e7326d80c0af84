"""`make pictures`: docs/pictures/robots.png, the built-in robots side by side, in one scale."""

import sys
from typing import Any

import mujoco
from PIL import Image

from tests.support.make_pictures import FOLDER, MOST, smaller
from twind.config.robot_file import load_robot

SIZE = 1280, 480  # pixels
SUPER = 2  # drawn larger, then reduced: smooth edges
# robot, pose, place forward and to the right (m), height of its base (m; None: the model's), turn (rad)
STAND = (
    ("koch", "ready", 0.25, -0.26, None, -0.7),
    ("so101", "ready", 0.0, -0.5, None, -0.6),
    ("h24", "arms_out", 0.0, 0.0, 0.456, 0.0),
    ("so101-leader", "ready", 0.0, 0.36, None, 0.3),
    ("quadruped12", "stand", -0.05, 0.76, 0.17, 0.45),
    ("pan-tilt", "rest", 0.3, 0.42, None, -0.2),
)
SCENE = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast" jacobian="dense"/>
  <visual>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.35 0.35 0.35" specular="0.1 0.1 0.1"/>
    <global fovy="28"/>
    <quality shadowsize="8192" offsamples="8"/>
  </visual>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="0.97 0.98 1" rgb2="0.72 0.78 0.85" width="8" height="48"/>
    <material name="floor" rgba="0.82 0.85 0.88 1" reflectance="0.06"/>
  </asset>
  <worldbody>
    <light pos="1.5 -0.8 2.5" dir="-0.5 0.3 -0.85" type="directional" diffuse="0.5 0.5 0.5"/>
    <geom type="plane" size="8 8 0.1" material="floor"/>
  </worldbody>
</mujoco>
"""


def main() -> int:
    """The picture; 1 where it is too large."""
    out = FOLDER / "robots.png"
    model, data = _scene()
    width, height = (SUPER * side for side in SIZE)
    model.vis.global_.offwidth = width
    model.vis.global_.offheight = height
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, _camera())
        Image.fromarray(renderer.render()).resize(SIZE, Image.Resampling.LANCZOS).save(out)
    smaller(out)
    print(f"{out}: {out.stat().st_size} bytes")
    return int(out.stat().st_size > MOST)


def _scene() -> tuple[Any, Any]:
    """All robots on one floor, each in its pose."""
    scene = mujoco.MjSpec.from_string(SCENE)
    angles = {}
    for name, pose, forward, right, height, turn in STAND:
        robot = load_robot(name)
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
        base = spec.body(robot.base)
        for joint in base.joints:
            spec.delete(joint)
        spec.delete(spec.geom("floor"))
        for light in spec.lights:
            spec.delete(light)
        if height is not None:
            base.pos[2] = height
        frame = scene.worldbody.add_frame(pos=[forward, right, 0.0], euler=[0.0, 0.0, turn])
        scene.attach(spec, prefix=f"{name}/", frame=frame)
        angles |= {f"{name}/{joint.model_joint}": robot.poses[pose][joint.name] for joint in robot.joints}
    model = scene.compile()
    data = mujoco.MjData(model)
    for joint, angle in angles.items():
        data.qpos[model.joint(joint).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return model, data


def _camera() -> Any:
    camera = mujoco.MjvCamera()
    camera.azimuth = 180.0
    camera.elevation = -12.0
    camera.distance = 1.85
    camera.lookat[:] = 0.0, 0.06, 0.23
    return camera


if __name__ == "__main__":
    sys.exit(main())
