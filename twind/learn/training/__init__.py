"""`twindctl train`: PPO of Stable-Baselines3 on the batch of simulations, judged beside doing nothing.

`training_settings.py` has what is trained and how, `training_folder.py` what is kept of it. `ppo_learner.py`
is the learner and writes the policy file, `evaluation.py` scores it, `trainer.py` is one training as a whole.
"""
