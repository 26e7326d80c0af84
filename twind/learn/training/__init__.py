"""`twindctl train`: PPO of Stable-Baselines3 on the batch of simulations, judged beside doing nothing.

`training_settings.py` says what is trained and how, `training_folder.py` what is kept of it, `ppo_learner.py`
is the learner, `evaluation.py` the judgement, `policy_export.py` the way into a policy file, `trainer.py` one
training as a whole.
"""
