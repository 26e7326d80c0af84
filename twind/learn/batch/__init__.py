"""Many environments as one: `mujoco.batch.Batch` on the machine's cores, without processes.

`body` simulates, `core` makes episodes of it; `vector` is what Gymnasium wants, `vec_env` Stable-Baselines3.
"""
