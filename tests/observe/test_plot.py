"""`twindctl plot`: what is drawn is what was recorded, what is missing is a gap, and the page can be read."""

import argparse
import re
from dataclasses import replace
from math import inf, isnan, nan
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from tests.support import sample_recordings as recorded
from twind.command_line.extras import how_to_add
from twind.command_line.verb import Rejected, UsageError
from twind.observe import plot
from twind.observe.plotting.plot_figure import DOTS, PAGE, figure, save
from twind.observe.plotting.plot_lines import MOST, line, marks, worst
from twind.observe.recording.recording_columns import (
    ExternalColumns,
    Floats,
    LatencyColumns,
    RecordedEpisode,
    RecordedMessage,
    RobotRecording,
    SlowColumns,
)

ALL = (-inf, inf)
ROWS = ("measured", "velocity", "effort", "goal", "simulated")


def recording(seconds: float = 2.0, joints: int = 24) -> RobotRecording:
    """A recording at 100 Hz: joint k has an error of k mrad, joint 0 is missing from 0.5 to 0.8 s."""
    time = np.arange(0.0, seconds, 0.01)
    goal = np.sin(time)[:, None] * np.ones(joints)
    measured = goal - 1e-3 * np.arange(joints)
    measured[(time > 0.5) & (time < 0.8), 0] = nan
    slow = np.arange(0.0, seconds, 0.5)
    table = np.full((slow.size, joints), 40.0) + np.arange(joints)
    return RobotRecording(
        path=Path("walk.mcap"),
        start_ns=1_800_000_000_000_000_000,
        joints=tuple(f"joint_{place}" for place in range(joints)),
        time=time,
        measured=measured,
        velocity=np.full_like(goal, nan),
        effort=np.full_like(goal, nan),
        goal=goal,
        simulated=np.full_like(goal, nan),
        statuses=(RecordedMessage(0.0, {"mode": "live"}),),
        slow=SlowColumns(slow, table, table - 28.0, np.ones_like(table), np.zeros_like(table)),
        latency={"total": LatencyColumns(slow, {"now_ms": np.full(slow.size, 2.5)}, ())},
        meta={"robot": "h24", "version": "1.2.3"},
    )


def drawn(page: Figure, label: str, name: str) -> tuple[Floats, Floats]:
    """Times and values of the line `name` in the panel whose axis label contains `label`."""
    (panel,) = [each for each in page.axes if label in each.get_ylabel()]
    (found,) = [each for each in panel.get_lines() if each.get_label() == name]
    return np.asarray(found.get_xdata(), float), np.asarray(found.get_ydata(), float)


def labels(page: Figure) -> list[str]:
    return [panel.get_ylabel().split("  ")[0].split("\n")[0] for panel in page.axes]


# ------------------------------------------------------------------------------------------ what is drawn


def test_drawn_lines_equal_the_recorded_values() -> None:
    whole = recording()
    page = figure(whole, None, ALL)
    time, value = drawn(page, "measured —", "joint_23 -")
    assert np.array_equal(time, whole.time) and np.array_equal(value, whole.measured[:, 23])
    assert np.array_equal(drawn(page, "measured —", "joint_23 :")[1], whole.goal[:, 23])
    assert np.allclose(drawn(page, "commanded less", "joint_7")[1], 7e-3)
    assert whole.slow is not None
    assert np.array_equal(drawn(page, "temperature", "joint_5")[1], whole.slow.temperature[:, 5])
    assert np.array_equal(drawn(page, "supply", "joint_5")[1], whole.slow.voltage[:, 5])
    assert np.array_equal(drawn(page, "latency", "total")[1], whole.latency["total"].columns["now_ms"])


def test_the_gap_of_the_statuses_is_drawn_where_the_daemon_had_one() -> None:
    def status(time: float, share: float | None) -> RecordedMessage:
        position = None if share is None else {"rms": 0.001, "nrmse_spread": 0.01, "unexplained": share}
        joints = [{"joint": "joint_1", "position": position}, {"joint": "joint_0", "position": None}]
        return RecordedMessage(time, {"mode": "live", "gap": {"joints": joints, "total": {}}})

    whole = recording()
    assert "gap: motion" not in labels(figure(whole, None, ALL))
    told = (RecordedMessage(0.0, {"mode": "live"}), status(0.5, 0.12), status(1.0, None), status(1.5, 0.3))
    time, value = drawn(figure(replace(whole, statuses=told), ["joint_1"], ALL), "gap", "joint_1")
    known = np.isfinite(value)
    assert time[known].tolist() == [0.5, 1.5] and value[known] == pytest.approx([12.0, 30.0])


def test_torque_from_outside_is_drawn_with_the_joints_in_contact() -> None:
    whole = recording()
    assert "from outside" not in labels(figure(whole, None, ALL))
    torque = np.zeros_like(whole.measured)
    torque[50:60, 3] = 2.0
    felt = ExternalColumns(whole.time, torque, np.full_like(torque, 0.1), torque > 1.0)
    page = figure(replace(whole, external=felt), ["joint_3"], ALL)
    assert np.array_equal(drawn(page, "from outside", "joint_3")[1], torque[:, 3])
    (panel,) = [each for each in page.axes if "from outside" in each.get_ylabel()]
    assert [each.get_text() for each in panel.texts] == ["contact: joint_3"]


def test_a_missing_value_is_a_gap() -> None:
    whole = recording()
    time, value = drawn(figure(whole, ["joint_0"], ALL), "measured —", "joint_0 -")
    (hole,) = np.flatnonzero(np.isnan(value))
    assert time[hole - 1] <= 0.5 and time[hole + 1] >= 0.8
    known = np.isfinite(value)
    assert np.array_equal(value[known], whole.measured[np.isfinite(whole.measured[:, 0]), 0])


def test_a_single_missing_value_is_bridged_and_two_are_a_gap() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    for missing, gaps in ((1, 0), (2, 1)):
        value = np.ones_like(time)
        value[50 : 50 + missing] = nan
        assert np.isnan(line(time, value, ALL).value).sum() == gaps


def test_a_value_alone_between_two_gaps_is_a_dot() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    value = np.ones_like(time)
    value[[3, 4, 50, 51, 52, 54, 55, 56, 97, 98]] = nan  # alone: 53 and 99; not: 0 to 2
    found = line(time, value, ALL)
    assert found.time[found.alone].tolist() == [time[53], time[99]]


def test_the_slower_half_of_a_file_with_two_rates_is_seen() -> None:
    fast = recording(seconds=1.0, joints=1)
    time = np.concatenate([fast.time, np.arange(1.0, 10.0, 0.1)])
    told = np.linspace(0.0, 1.0, time.size)[:, None]
    nothing = np.full_like(told, nan)
    rates = {"time": time, "measured": told, "goal": nothing, "velocity": nothing}
    both = replace(fast, **rates, effort=nothing, simulated=nothing, slow=None, latency={})  # type: ignore[arg-type]
    page = figure(both, None, ALL)
    assert isinstance(page.canvas, FigureCanvasAgg)
    page.canvas.draw()
    pixels = np.asarray(page.canvas.buffer_rgba())[..., :3].astype(int)
    box = page.axes[0].get_window_extent()
    inside = pixels[int(pixels.shape[0] - box.y1) : int(pixels.shape[0] - box.y0), int(box.x0) : int(box.x1)]
    blue = (inside[..., 2] - inside[..., 0] > 60).any(axis=0)
    assert blue[int(0.11 * blue.size) :].sum() > 90, "one value of ten a second is at least a column"


def test_the_thinned_line_of_an_hour_keeps_every_peak() -> None:
    time = np.arange(0.0, 3600.0, 0.01)
    value = np.sin(time)
    value[123_457] = 9.0
    value[234_561:234_900] = nan
    thin = line(time, value, ALL)
    assert thin.time.size <= MOST + 1
    assert np.nanmax(thin.value) == 9.0 and (np.diff(thin.time) >= 0.0).all()
    assert isnan(
        thin.value[np.searchsorted(thin.time, 2346.5) - 1 : np.searchsorted(thin.time, 2349.5)].sum()
    )


def test_panels_of_which_nothing_is_known_are_left_out() -> None:
    assert labels(figure(recording(), None, ALL)) == [
        "commanded ···",
        "commanded less",
        "latency",
        "temperature",
        "supply",
    ]
    bare = replace(recording(), slow=None, latency={}, goal=np.full((200, 24), nan))
    assert labels(figure(bare, None, ALL)) == ["commanded ···"]


def test_a_line_that_changes_from_the_robot_to_its_simulation_is_called_both() -> None:
    whole = recording()
    modes = tuple(RecordedMessage(time, {"mode": mode}) for time, mode in ((0.0, "live"), (1.0, "sim")))
    page = figure(replace(whole, simulated=whole.measured, statuses=modes), None, ALL)
    for panel in page.axes[:2]:
        assert "measured (live), simulated" in panel.get_ylabel()


def test_a_simulated_robot_is_called_one() -> None:
    whole = recording()
    page = figure(
        replace(
            whole,
            simulated=whole.measured,
            measured=whole.effort,
            statuses=(RecordedMessage(0.0, {"mode": "sim"}),),
        ),
        None,
        ALL,
    )
    assert "simulated" in page.axes[0].get_ylabel()


# ------------------------------------------------------------------------------------------------- joints


def test_the_worst_are_in_colour_and_the_others_grey() -> None:
    page = figure(recording(), None, ALL)
    legend = page.axes[0].get_legend()
    assert legend is not None
    told = [text.get_text() for text in legend.get_texts()]
    assert told == [f"joint_{place}" for place in (23, 22, 21, 20, 19, 18)] + ["the others"]
    colours = {str(each.get_label()): each.get_color() for each in page.axes[1].get_lines()}
    assert len(colours) == 24
    assert len({colours[name] for name in told[:-1]}) == 6
    assert {colours[f"joint_{place}"] for place in range(18)} == {"0.80"}


def test_without_goals_the_worst_are_those_that_move_most() -> None:
    still = np.zeros((200, 3))
    still[:, 1] = np.linspace(0.0, 1.0, 200)
    moving = replace(recording(joints=3), goal=np.full((200, 3), nan), measured=still)
    assert worst(moving, ALL)[0] == "joint_1"


@pytest.mark.parametrize(
    ("joints", "why"), [(["joint_99"], "known: joint_0, "), ([], "0 joints"), (9 * ["joint_1"], "1 to 8")]
)
def test_joints_that_cannot_be_drawn_are_refused_with_those_that_can(joints: list[str], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        figure(recording(), joints, ALL)


def test_a_stretch_without_anything_is_refused_with_how_long_it_is() -> None:
    with pytest.raises(ValueError, match=r"it has 1\.990 s"):
        figure(recording(), None, (5.0, 6.0))


def test_a_stretch_is_what_is_drawn() -> None:
    page = figure(recording(), None, (0.9, 1.5))
    time, _ = drawn(page, "measured —", "joint_23 -")
    assert (time[0], time[-1]) == pytest.approx((0.9, 1.5)) and page.axes[0].get_xlim() == (0.9, 1.5)


# -------------------------------------------------------------------------------------------------- marks


@pytest.mark.parametrize("state", ["fault", "estop", "inhibited"])
def test_a_state_that_needs_acknowledgement_is_marked_in_every_panel(state: str) -> None:
    told = {"level": "info", "code": state, "message": f"armed → {state}"}
    (mark,) = marks(replace(recording(), events=(RecordedMessage(1.5, told),), verdicts=()), ALL)
    assert (mark.time, mark.text, mark.bad) == (1.5, state, True)


def test_events_are_marked_with_their_text_and_faults_in_every_panel() -> None:
    annotation = {"kind": "end", "task": "pick", "success": True, "text": None}
    happened = replace(
        recording(),
        events=(
            RecordedMessage(0.2, {"level": "info", "code": "ARMED"}),
            RecordedMessage(1.5, {"level": "error", "code": "OVERTEMP"}),
            RecordedMessage(1.0, {"level": "info", "code": "EPISODE_END", "annotation": annotation}),
        ),
        verdicts=(
            RecordedMessage(0.5, {"refusals": [{"code": "POS_LIMIT"}]}),
            RecordedMessage(0.6, {"refusals": []}),
        ),
        episodes=(RecordedEpisode("pick", nan, 1.0, True),),
    )
    told = [(mark.time, mark.text, mark.bad) for mark in marks(happened, ALL)]
    assert told == [
        (0.5, "refused: POS_LIMIT", True),
        (1.0, "end pick success", False),
        (1.5, "OVERTEMP", True),
    ]
    page = figure(happened, None, ALL)
    for panel in page.axes:
        through = {each.get_xdata()[0] for each in panel.get_lines() if each.get_linestyle() == "--"}  # type: ignore[index]
        assert through == {0.5, 1.5}
        (shade,) = panel.patches
        assert shade.get_extents().x0 == pytest.approx(panel.transData.transform((0.0, 0.0))[0])
    assert {text.get_text() for text in page.axes[-1].texts} == {text for _, text, _ in told}


def test_events_after_the_last_reading_are_on_the_page() -> None:
    whole = replace(
        recording(),
        events=(RecordedMessage(2.4, {"level": "error", "code": "STATE_STALE"}),),
        verdicts=(RecordedMessage(2.6, {"refusals": [{"code": "NOT_ARMED"}]}),),
    )
    page = figure(whole, None, ALL)
    assert page.axes[0].get_xlim() == (0.0, 2.6)
    assert [text.get_text() for text in page.axes[-1].texts] == ["STATE_STALE", "refused: NOT_ARMED"]
    alone = replace(
        whole,
        time=np.zeros(0),
        **dict.fromkeys(ROWS, np.zeros((0, 24))),
        slow=None,
        latency={},  # type: ignore[arg-type]
    )
    assert labels(figure(alone, None, ALL)) == ["what happened"]


def test_a_dollar_in_a_name_or_a_mark_is_no_formula(tmp_path: Path) -> None:
    annotation = {"kind": "note", "task": None, "success": None, "text": r"cost $\foo$"}
    whole = replace(
        recording(joints=2),
        joints=(r"$\hip$", "knee"),
        events=(RecordedMessage(0.2, {"level": "info", "code": "NOTE", "annotation": annotation}),),
        meta={"individual": r"$\bar$"},
    )
    save(figure(whole, None, ALL), tmp_path / "page.png")
    assert (tmp_path / "page.png").stat().st_size > 10_000


# -------------------------------------------------------------------------------------------- the command


def options(file: Path, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    plot.add_arguments(parser)
    return parser.parse_args([str(file), *words])


def test_a_recording_becomes_a_page_of_a4_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recorded.write(tmp_path / "short.mcap", 2.0)
    assert plot.run(options(file)) == 0
    assert capsys.readouterr().out.startswith(f"{file}.png: 2.0 s of 2 joints")
    pixels = imread(f"{file}.png")
    assert pixels.shape[:2] == (int(PAGE[1] * DOTS), int(PAGE[0] * DOTS))
    assert 0.01 < float((pixels[..., :3].min(axis=2) < 0.9).mean()) < 0.5, "an empty page, or a black one"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["short.mcap", "short.mcap.png"]


def test_an_invalid_plot_request_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    file = recorded.write(tmp_path / "short.mcap", 0.5)
    with pytest.raises(Rejected, match="no joint 'elbow'; known: hip, knee"):
        plot.run(options(file, "--joints", "elbow"))
    with pytest.raises(UsageError, match="nothing between"):
        plot.run(options(file, "--from", "2", "--to", "1"))
    with pytest.raises(Rejected, match="No such file"):
        plot.run(options(file, "--out", str(tmp_path / "nowhere" / "x.png")))
    (tmp_path / "text.mcap").write_text("text")
    with pytest.raises(Rejected, match="neither"):
        plot.run(options(tmp_path / "text.mcap"))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["short.mcap", "text.mcap"]


def test_only_a_picture_is_written_over_never_a_recording(tmp_path: Path) -> None:
    file = recorded.write(tmp_path / "short.mcap", 0.5)
    whole = file.read_bytes()
    (tmp_path / "link.png").symlink_to(file)
    (tmp_path / "short.mcap.png").write_text("notes")
    (tmp_path / "folder.png").mkdir()
    for words in (["--out", str(file)], ["--out", str(tmp_path / "link.png")], []):
        with pytest.raises(Rejected, match="no PNG, and it stays"):
            plot.run(options(file, *words))
    with pytest.raises(Rejected, match=r"folder\.png: there is something"):
        plot.run(options(file, "--out", str(tmp_path / "folder.png")))
    assert file.read_bytes() == whole and (tmp_path / "short.mcap.png").read_text() == "notes"
    page = tmp_path / "page.png"
    page.write_bytes(plot.PNG)  # a picture of before
    assert plot.run(options(file, "--out", str(page))) == 0
    assert imread(page).shape[:2] == (int(PAGE[1] * DOTS), int(PAGE[0] * DOTS))


def test_a_missing_matplotlib_is_reported_with_its_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plot, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=re.escape(how_to_add("plot"))):
        plot.run(options(tmp_path / "any.mcap"))
