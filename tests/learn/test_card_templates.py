"""Templates of cards: each is a card that fits the robot that it is written for."""

import numpy as np
import pytest

from twind.config.robot_file import load_robot
from twind.learn.cards.card_actor import default_pose, require_card_fit
from twind.learn.cards.card_observer import CardObserver
from twind.learn.cards.card_templates import FOLDER, breadth_first, model_order, template_text
from twind.learn.cards.interface_card import parse_card
from twind.learn.policy.policy_command import TEMPLATES
from twind.learn.task.plant_model import plant_of

ROBOT = load_robot("h24-standing")


def test_every_template_has_an_option() -> None:
    assert tuple(sorted(path.stem for path in FOLDER.iterdir())) == TEMPLATES


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_a_card_that_fits_the_robot(name: str) -> None:
    text = template_text(name, ROBOT)
    card = parse_card(text, name)
    limits = plant_of(ROBOT, period=0.01).binding.limits
    require_card_fit(card, ROBOT.names, limits)
    pose = default_pose(card, ROBOT.names, np.zeros(24))
    assert CardObserver(card, ROBOT.names, pose).inputs["obs"].shape[0] == 1
    assert ("Sources" in text and "unverified" in text) or name == "playground"


def test_isaac_lab_lists_joints_breadth_first_and_the_others_as_the_model() -> None:
    assert model_order(ROBOT) == list(ROBOT.names)
    wide = breadth_first(ROBOT)
    assert sorted(wide) == sorted(ROBOT.names)
    assert wide.index("r_hip_yaw") < wide.index("l_hip_roll") < wide.index("l_knee")


def test_the_single_observation_of_toddlerbot_has_all_joints_and_acts_on_the_legs() -> None:
    card = parse_card(template_text("toddlerbot", ROBOT), "x")
    size = 2 + 3 + 24 + 24 + 12 + 3 + 4
    assert CardObserver(card, ROBOT.names, np.zeros(24)).inputs["obs"].shape == (1, 15 * size)
