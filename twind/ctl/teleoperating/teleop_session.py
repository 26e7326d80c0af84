"""One run of `twindctl teleop`: from held controls to setpoints, poses and motions, until it is ended."""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from twind.client import CallError, ClientError, MotionFailed
from twind.ctl.reasons.refusal_text import refusal_text
from twind.ctl.teleoperating.teleop_input import TeleopInput
from twind.ctl.teleoperating.teleop_mapping import (
    SELECTED,
    JogBinding,
    MotionBinding,
    PoseBinding,
    SelectBinding,
    StopBinding,
    TeleopMapping,
)
from twind.exceptions import InvalidInput
from twind.robot_client.held_jog import PERIOD, follow_while_held
from twind.robot_client.jog_motion import JogMotion, JogRequest, joints_of, known_positions, plan_jog
from twind.robot_client.robot import Robot

Tell = Callable[[str], None]


class TeleopSession:
    """Moves `robot` by `controls`. Of one thread."""

    def __init__(
        self,
        robot: Robot,
        description: Mapping[str, Any],
        mapping: TeleopMapping,
        controls: TeleopInput,
        *,
        show: Tell,
        tell: Tell,
    ) -> None:
        """`description`: as in the answer of `GetRobot`; `show`: the state now; `tell`: what happened."""
        self._robot = robot
        self._description = description
        self._joints = joints_of(description)
        self._bindings = mapping.bindings
        self._controls = controls
        self._show = show
        self._tell = tell
        self._names = list(self._joints)
        self._selected = 0
        self._is_spent = False  # what is held was refused or stopped: it must be released first
        self._refused = ""

    def run(self, ended: threading.Event) -> None:
        """Move while controls are held, until `ended`; then it holds. Raises EOFError, KeyboardInterrupt."""
        while not ended.is_set():
            begun = time.monotonic()
            held = self._poll(begun)
            if not held:
                self._is_spent = False
            elif not self._is_spent:
                self._engage(ended)
            self._show(self._state_text())
            time.sleep(max(0.0, begun + PERIOD - time.monotonic()))

    # ------------------------------------------------------------------------------------------ controls

    def _poll(self, now: float) -> Mapping[str, float]:
        """Return the held controls that move something. Stops and selects at once."""
        self._controls.take(now)
        for name in self._controls.pressed():
            match self._bindings.get(name):
                case StopBinding():
                    self._is_spent = True
                    self._robot.stop()
                    self._tell("stopped")
                case SelectBinding(step):
                    self._selected = (self._selected + step) % len(self._names)
        held = self._controls.held(now)
        return {
            name: far
            for name, far in held.items()
            if isinstance(self._bindings.get(name), JogBinding | PoseBinding | MotionBinding)
        }

    def _holds(self, name: str, ended: threading.Event) -> bool:
        """Return whether this control alone is held, for a pose or a motion."""
        held = self._poll(time.monotonic())
        return not self._is_spent and not ended.is_set() and list(held) == [name]

    def _velocities(self, held: Mapping[str, float]) -> dict[str, float]:
        """Return the speeds (rad/s, by joint) that held controls ask for; those of one joint are added."""
        speeds: dict[str, float] = {}
        for name, far in held.items():
            binding = self._bindings[name]
            if isinstance(binding, JogBinding):
                joint = self._names[self._selected] if binding.joint == SELECTED else binding.joint
                speeds[joint] = speeds.get(joint, 0.0) + far * binding.speed
        return {joint: speed for joint, speed in speeds.items() if speed}

    # ------------------------------------------------------------------------------------------ motions

    def _engage(self, ended: threading.Event) -> None:
        """Move for as long as a control is held; what is refused must be released first."""
        held = self._poll(time.monotonic())
        name, binding = next(((name, self._bindings[name]) for name in held), ("", None))
        try:
            match binding:
                case JogBinding():
                    self._jog(held, ended)
                case PoseBinding(pose):
                    self._pose(name, pose, ended)
                case MotionBinding(motion) if self._controls.is_kept(name):
                    self._play(name, motion, ended)
                case _:
                    return
            self._robot.stop()
        except (EOFError, KeyboardInterrupt):
            with contextlib.suppress(ClientError):
                self._robot.stop()
            raise
        except MotionFailed as error:
            self._end(str(error) if error.phase != "cancelled" else "")
        except CallError as error:
            self._end(": ".join(refusal_text(error)))
        except (ClientError, InvalidInput) as error:
            self._end(str(error))

    def _end(self, why: str) -> None:
        self._is_spent = True
        if why:
            self._tell(why)

    def _jog(self, held: Mapping[str, float], ended: threading.Event) -> None:
        """Follow held joints; joints that join later begin a stream of all, without a stop between."""
        wanted = self._velocities(held)
        motion = JogMotion([], np.zeros(0), np.zeros(0), np.zeros(0))

        def steer(motion: JogMotion, now: float) -> bool:
            wanted.clear()
            if not self._is_spent and not ended.is_set():
                wanted.update(self._velocities(self._poll(now)))
            motion.steer(wanted, self._joints)
            self._show(self._state_text())
            return bool(wanted) and set(wanted) <= set(motion.names)

        while wanted:
            motion = self._joined(motion, list(wanted))
            stream = self._robot.stream(motion.names, rate=1.0 / PERIOD)
            follow_while_held(stream, motion, steer)

    def _joined(self, motion: JogMotion, names: list[str]) -> JogMotion:
        """Return the motion with joints that join it where they are commanded. Raises InvalidInput."""
        fresh = [name for name in names if name not in motion.names]
        start = np.concatenate([motion.position, known_positions(fresh, self._goals())])
        return JogMotion([*motion.names, *fresh], start, start, np.zeros(len(start)))

    def _pose(self, control: str, pose: str, ended: threading.Event) -> None:
        motion = plan_jog(JogRequest("pose", pose), self._description, self._goals())

        def steer(motion: JogMotion, now: float) -> bool:
            self._show(f"pose {pose}: {'there' if motion.is_done else 'on the way'}")
            return self._holds(control, ended)

        follow_while_held(self._robot.stream(motion.names, rate=1.0 / PERIOD), motion, steer)

    def _play(self, control: str, motion: str, ended: threading.Event) -> None:
        """Play a motion in a thread of its own, and stop it with the release."""
        playing = MotionThread(self._robot, motion)
        while playing.is_alive() and self._holds(control, ended):
            self._show(f"motion {motion}")
            time.sleep(PERIOD)
        if playing.is_alive():
            self._robot.stop()
        playing.join()
        self._is_spent = True
        if playing.failure is not None:
            raise playing.failure

    # -------------------------------------------------------------------------------------------- state

    def _goals(self) -> Mapping[str, float | None]:
        """Return what each joint is commanded, or else its position, rad."""
        state = self._robot.state
        known = np.where(np.isfinite(state.goal), state.goal, state.position)
        return dict(zip(state.names, known.tolist(), strict=True))

    def _state_text(self) -> str:
        name = self._names[self._selected]
        joint = self._robot.joints[name]
        at = joint.position if joint.goal is None else joint.goal
        return f"{name} {'–' if at is None else f'{at:.3f} rad'}"


class MotionThread(threading.Thread):
    """Plays one motion of a robot."""

    def __init__(self, robot: Robot, motion: str) -> None:
        super().__init__(name="motion", daemon=True)
        self.failure: Exception | None = None
        self._robot = robot
        self._motion = motion
        self.start()

    def run(self) -> None:
        """Play it to its end; keep its failure."""
        try:
            self._robot.play(self._motion)
        except (ClientError, InvalidInput) as error:
            self.failure = error
