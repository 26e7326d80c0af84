"""`gymnasium.make("twind.learn.envs:twind/Stand-v0")` knows the environments by this import.

The one module here whose import does something: Gymnasium reads no entry points of packages, but imports what
stands before the colon.
"""

import gymnasium

from twind.learn.task.learning_tasks import TASKS

for _task in TASKS.values():
    gymnasium.register(
        id=f"twind/{_task.name}-v0",
        entry_point="twind.learn.environment.robot_env:RobotEnv",
        vector_entry_point="twind.learn.batch.vector_env:BatchVectorEnv",
        kwargs={"task": _task.name},
    )
