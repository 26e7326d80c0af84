"""`twindctl train`: PPO of Stable-Baselines3 on the batch of simulations, judged beside doing nothing.

`settings.py` says what is trained and how, `folder.py` what is kept of it, `learner.py` is the learner,
`evaluation.py` the judgement, `export.py` the way into a policy file, `course.py` one training as a whole.
"""
