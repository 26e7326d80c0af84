"""Rows of joints on the viewer's page: names are escaped, values that are not known are null."""

import json

import numpy as np

from tests.support.viewer_messages import h24
from twind.observe.viewing.joint_html import joint_rows, joint_values

ROBOT = h24()["robot"]


def test_buttons_are_there_only_where_the_page_may_move_the_robot() -> None:
    assert "data-twind-kind" not in joint_rows(ROBOT, jogs=False)
    page = joint_rows(ROBOT, jogs=True)
    assert page.count('data-twind-kind="up"') == page.count('data-twind-kind="down"') == len(ROBOT["joints"])
    assert page.count('data-twind-kind="to"') == len(ROBOT["joints"])
    assert page.count('data-twind-kind="pose"') == len(ROBOT["poses"])


def test_names_from_a_robot_file_are_escaped() -> None:
    joint = ROBOT["joints"][0] | {"name": '"><script>alert(1)</script>'}
    page = joint_rows({"joints": [joint], "poses": {"<b>": {}}}, jogs=True)
    assert "<script>" not in page and "<b>" not in page


def test_unknown_values_are_null() -> None:
    contact = np.array([False, True])
    told = joint_values(np.array([0.5, np.nan]), np.array([np.inf, -0.25]), np.array([np.nan, 1.5]), contact)
    known = {"position": [0.5, None], "goal": [None, -0.25], "external": [None, 1.5]}
    assert json.loads(told) == known | {"contact": [False, True]}
