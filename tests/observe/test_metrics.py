"""`twindctl metrics`: exported values, dashboard and alert rules, listening addresses. Nothing is served."""

import argparse
import errno
import json
import os
import re
import shutil
import socket
import stat
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.openmetrics.exposition import generate_latest as openmetrics
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from tests.support.metrics_messages import bucket, event, joint, latency, state, status, verdict
from twind.command_line.verb import Rejected, UsageError
from twind.observe import metrics
from twind.observe.measuring import metrics_server as metrics_serve
from twind.observe.measuring.metric_families import families
from twind.observe.measuring.metrics_ledger import STALE, MetricsLedger
from twind.robot.finding import ReasonCode

FILES = Path(__file__).parents[2] / "packaging" / "metrics"
NOW = 100.0
WALL = 1_800_000_000.0

Samples = Mapping[tuple[str, frozenset[tuple[str, str]]], float]
Queried = tuple[Mapping[str, str], str, str, Mapping[str, float]]  # series, query, time, samples


class Exported:
    """Metrics that a ledger exports at `now`."""

    def __init__(self, ledger: MetricsLedger, now: float = NOW) -> None:
        self.registry = CollectorRegistry()
        self.ledger = ledger
        self.now = now
        self.registry.register(self)  # type: ignore[arg-type]

    def collect(self) -> Any:
        return families(self.ledger.news(self.now))

    @property
    def samples(self) -> Samples:
        text = openmetrics(self.registry).decode()
        return {
            (sample.name, frozenset(sample.labels.items())): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }

    def value(self, name: str, **labels: str) -> float | None:
        return self.samples.get((name, frozenset(labels.items())))


def ledger(*messages: Mapping[str, Any], now: float = NOW) -> MetricsLedger:
    made = MetricsLedger(WALL)
    for message in messages:
        made.take(message, now, WALL + now)
    return made


WHOLE = (status(), state(), latency([bucket(1.0, 5), bucket(2.0, 4), bucket(None, 1)], 12.0))


# ---------------------------------------------------------------------------------------------- values


def test_metrics_are_exported_in_base_units() -> None:
    out = Exported(ledger(*WHOLE))
    assert out.value("twind_up") == 1.0
    assert out.value("twind_joint_position_radians", joint="a") == 0.5
    assert out.value("twind_joint_goal_radians", joint="a") == 0.75
    assert out.value("twind_joint_temperature_celsius", joint="b") == 41.0
    assert out.value("twind_joint_age_seconds", joint="a") == pytest.approx(0.012)
    assert out.value("twind_joint_heard", joint="b") == 0.0
    assert out.value("twind_joint_fault", joint="b", fault="overload") == 1.0
    assert out.value("twind_state_latency_seconds") == pytest.approx(0.0125)
    assert out.value("twind_lease_held") == 1.0
    assert out.value("twind_faults") == out.value("twind_fault", code="STATE_STALE", joint="b") == 1.0
    assert out.value("twind_bus_errors_total", bus="main") == 3.0
    assert out.value("twind_flight_span_seconds") == 30.0
    assert out.value("twind_info", version="1.2.3", robot="h24") == 1.0


def test_denied_realtime_is_read_from_its_field_and_not_from_its_text() -> None:
    out = Exported(ledger(*WHOLE))
    assert out.value("twind_realtime_granted", what="cpu") == 1.0
    assert out.value("twind_realtime_granted", what="memory") == 0.0
    older = {key: value for key, value in status()["status"]["loop"].items() if key != "realtime_denied"}
    assert (
        Exported(ledger(status(loop=older), *WHOLE[1:])).value("twind_realtime_granted", what="cpu") is None
    )


def test_streamer_metrics_are_summed_and_absent_without_streamers() -> None:
    assert Exported(ledger(*WHOLE)).value("twind_stream_sent_messages") is None
    one = {"sent": 5, "waiting": 1, "dropped": 0, "dead": 2}
    out = Exported(ledger(status(streams=[one, {**one, "sent": 7}]), *WHOLE[1:]))
    assert out.value("twind_stream_sent_messages") == 12.0
    assert out.value("twind_stream_dead_messages") == 4.0


def test_an_unknown_value_has_no_sample() -> None:
    out = Exported(ledger(*WHOLE))
    for name in ("effort_newton_meters", "verified"):
        assert out.value(f"twind_joint_{name}", joint="a") is None
    assert out.value("twind_joint_age_seconds", joint="b") is None
    assert out.value("twind_bus_skew_seconds") is None


def test_a_state_is_one_of_all_and_a_new_one_is_added() -> None:
    out = Exported(ledger(status(state="dancing"), state()))
    assert out.value("twind_state", twind_state="dancing") == 1.0
    assert out.value("twind_state", twind_state="armed") == 0.0
    assert out.value("twind_mode", twind_mode="live") == 1.0


def test_buckets_become_those_that_hold_all_below_them() -> None:
    out = Exported(ledger(*WHOLE))
    for upper, count in (("0.001", 5), ("0.002", 9), ("+Inf", 10)):
        assert out.value("twind_latency_seconds_bucket", hop="reply", le=upper) == count
    assert out.value("twind_latency_seconds_count", hop="reply") == 10
    assert out.value("twind_latency_seconds_sum", hop="reply") == pytest.approx(0.012)
    assert out.value("twind_loop_lateness_seconds_bucket", le="0.0001") == 900
    assert out.value("twind_loop_lateness_seconds_sum") == pytest.approx(0.25)


def test_between_two_histograms_the_last_one_holds() -> None:
    made = ledger(*WHOLE, latency(None))
    assert Exported(made).value("twind_latency_seconds_bucket", hop="reply", le="0.002") == 9
    assert made.is_complete
    assert not ledger(status(), state(), latency(None)).is_complete


def test_verdicts_and_events_are_counted_each_reason_once() -> None:
    out = Exported(
        ledger(*WHOLE, verdict("POS_LIMIT", "POS_LIMIT", "VEL_LIMIT"), verdict(), event("OVERTEMP", 7))
    )
    assert out.value("twind_refusals_total", code="POS_LIMIT") == 1.0
    assert out.value("twind_refusals_total", code="VEL_LIMIT") == 1.0
    assert out.value("twind_verdicts_total", verdict="refused") == 1.0
    assert out.value("twind_verdicts_total", verdict="accepted") == 1.0
    assert out.value("twind_events_total", code="OVERTEMP") == 1.0
    assert out.value("twind_exporter_lost_messages_total") == 7.0
    assert out.value("twind_refusals_total", code="FLOOR") == 0.0  # it will have increased when it comes


# ------------------------------------------------------------------------------------- what is not there


def names(samples: Samples) -> set[str]:
    return {name for name, _ in samples}


@pytest.mark.parametrize("made", [ledger(), ledger(status()), ledger(state()), ledger(verdict("FLOOR"))])
def test_before_all_topics_arrived_only_the_up_metric_is_exported(made: MetricsLedger) -> None:
    assert Exported(made).samples == {("twind_up", frozenset()): 0.0}


def test_a_daemon_that_is_silent_or_gone_leaves_no_old_value_behind() -> None:
    made = ledger(*WHOLE, verdict("FLOOR"))
    assert Exported(made, NOW + STALE).value("twind_news_age_seconds") == STALE
    assert Exported(made, NOW + STALE + 0.01).samples == {("twind_up", frozenset()): 0.0}
    made.forget()
    assert Exported(made).samples == {("twind_up", frozenset()): 0.0}
    for message in WHOLE:
        made.take(message, NOW + 9.0, WALL)
    assert Exported(made, NOW + 9.0).value("twind_refusals_total", code="FLOOR") == 1.0  # ours: counted on


def test_verdicts_alone_are_no_sign_of_a_loop_that_lives() -> None:
    made = ledger(*WHOLE)
    made.take(verdict(), NOW + STALE + 1.0, WALL)
    assert made.news(NOW + STALE + 1.0) is None


@pytest.mark.parametrize(
    "malformed",
    [
        {"topic": "state", "time": 60.0},
        {"topic": "status", "time": 60.0, "status": {}},
        {"topic": "latency", "latency": [{"hop": "reply", "violations": 0}, {}]},
    ],
)
def test_a_message_that_is_not_understood_is_no_news(malformed: Mapping[str, Any]) -> None:
    made = ledger(*WHOLE)
    with pytest.raises(KeyError):
        made.take(malformed, NOW + STALE, WALL)
    assert made.news(NOW + STALE + 0.01) is None, "it counts as heard from"
    out = Exported(made)
    assert out.value("twind_latency_seconds_count", hop="reply") == 10.0, "half of a message was kept"


@pytest.mark.parametrize(
    ("messages", "ended"), [(WHOLE, 0), ([status(), latency(None)], 3), ([], 3), ([state()], 3)]
)
def test_to_print_that_nothing_is_known_is_no_success(
    messages: list[Mapping[str, Any]],
    ended: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Saying:
        timeout = 1.0

        def stream(self, method: str, **parameters: Any) -> Iterator[Mapping[str, Any]]:
            yield from messages

    monkeypatch.setattr(metrics_serve, "observer", lambda options: nullcontext(Saying()))
    assert metrics_serve.once(argparse.Namespace(json=False, text=False)) == ended
    printed = capsys.readouterr()
    assert f"twind_up {float(ended == 0)}" in printed.out
    assert ("sent too little" in printed.err) == (ended == 3)


def test_a_count_goes_down_with_a_new_beginning_alone() -> None:
    made = ledger(*WHOLE)
    first = Exported(made).value("twind_loop_ticks_created")
    made.take(status(ticks=1090, missed=10, time=61.0), NOW + 1.0, WALL + NOW + 1.0)
    assert Exported(made, NOW + 1.0).value("twind_loop_ticks_created") == first
    made.take(status(ticks=1200, time=90.0), NOW + 30.0, WALL + NOW + 30.0)  # more ticks, of another run
    out = Exported(made, NOW + 30.0)
    created = out.value("twind_loop_ticks_created")
    assert first is not None and created is not None and created - first == pytest.approx(28.0)
    assert out.value("twind_bus_errors_created", bus="main") == created
    assert out.value("twind_latency_seconds_count", hop="reply") is None  # those of the run before


def test_the_number_of_series_is_bounded_by_robot_and_interface() -> None:
    joints = [joint(f"joint_{place}") for place in range(24)]
    many = [verdict(str(code)) for code in ReasonCode] * 50
    samples = Exported(ledger(status(), state(*joints), WHOLE[2], *many)).samples
    assert len(samples) < 24 * 12 + 4 * len(ReasonCode) + 120


# ---------------------------------------------------------------------------------------- files beside it


def asked() -> set[str]:
    """Every name of ours that a panel or a rule asks for."""
    board = json.loads((FILES / "twind-dashboard.json").read_text())
    rules = yaml.safe_load((FILES / "twind.rules.yml").read_text())
    said = [target["expr"] for panel in board["panels"] for target in panel.get("targets", ())]
    said += [variable["definition"] for variable in board["templating"]["list"] if "definition" in variable]
    said += [rule["expr"] for group in rules["groups"] for rule in group["rules"]]
    assert len(said) > 40
    return {name for each in said for name in re.findall(r"\b(twind_\w+)", each)}


def test_dashboard_and_alert_rules_use_only_exported_metrics() -> None:
    known = names(Exported(ledger(*WHOLE)).samples)
    empty = {"twind_joint_effort_newton_meters", "twind_joint_verified"}  # unknown to this robot
    assert asked() - empty <= known
    assert empty <= {family.name for family in families(ledger(*WHOLE).news(NOW))}


def test_the_page_names_every_figure_and_no_other() -> None:
    page = (FILES.parents[1] / "docs" / "observe.md").read_text()
    told = set(re.findall(r"`(twind_\w+)", page))
    there = set()
    for family in families(ledger(*WHOLE).news(NOW)):
        suffix = {"counter": "_total", "info": "_info"}.get(family.type, "")
        there.add(family.name + suffix)
    assert told == there


def test_panels_do_not_overlap_and_have_each_a_number_of_their_own() -> None:
    panels = json.loads((FILES / "twind-dashboard.json").read_text())["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    taken = [
        (panel["gridPos"]["x"] + right, panel["gridPos"]["y"] + down)
        for panel in panels
        for right in range(panel["gridPos"]["w"])
        for down in range(panel["gridPos"]["h"])
    ]
    assert len(set(taken)) == len(taken) and max(x for x, _ in taken) < 24


@pytest.fixture
def promtool() -> str:
    found = shutil.which("promtool")
    if found is None:
        pytest.skip("no promtool here (Debian: prometheus)")
    return found


def check_queries(promtool: str, folder: Path, rules: Sequence[str], cases: Sequence[Queried]) -> None:
    """Evaluate each case: its series, query, time of the query and expected samples by labels."""
    tests = [
        {
            "interval": "10s",
            "input_series": [{"series": name, "values": values} for name, values in series.items()],
            "promql_expr_test": [
                {
                    "expr": query,
                    "eval_time": time,
                    "exp_samples": [{"labels": labels, "value": value} for labels, value in samples.items()],
                }
            ],
        }
        for series, query, time, samples in cases
    ]
    file = folder / "tests.yml"
    file.write_text(yaml.safe_dump({"rule_files": rules, "evaluation_interval": "10s", "tests": tests}))
    done = subprocess.run([promtool, "test", "rules", str(file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_prometheus_linter_accepts_the_exported_text(promtool: str) -> None:
    text = generate_latest(Exported(ledger(*WHOLE)).registry)
    done = subprocess.run([promtool, "check", "metrics"], input=text, capture_output=True, check=False)
    said = [line for line in done.stderr.decode().splitlines() if "_created" not in line]
    assert said == [], said  # `_created` is OpenMetrics' own name, and no counter to the linter


@pytest.mark.parametrize(
    ("mode", "error"),
    [("live", {"a": 0.5}), ("mirror", {"a": 0.125, "b": 0.25}), ("sim", {"a": 0.125, "b": 0.25})],
)
def test_the_error_on_the_dashboard_is_of_what_follows_the_commands(
    promtool: str, tmp_path: Path, mode: str, error: Mapping[str, float]
) -> None:
    board = json.loads((FILES / "twind-dashboard.json").read_text())
    (panel,) = [each for each in board["panels"] if each["title"].startswith("Commanded less")]
    asked = panel["targets"][0]["expr"].replace("$instance", "r").replace("$joint", ".*")
    told = {"goal": {"a": 1.0, "b": 1.0}, "position": {"a": 0.5}, "simulated": {"a": 0.875, "b": 0.75}}
    series = {
        f'twind_joint_{name}_radians{{job="twind", instance="{robot}", joint="{joint}"}}': value
        for name, joints in told.items()
        for joint, value in joints.items()
        for robot in ("r", "another")
    }
    for each in ("live", "mirror", "sim"):
        series[f'twind_mode{{job="twind", instance="r", twind_mode="{each}"}}'] = float(each == mode)
        series[f'twind_mode{{job="twind", instance="another", twind_mode="{each}"}}'] = float(each == "live")
    samples = {f'{{job="twind", instance="r", joint="{joint}"}}': value for joint, value in error.items()}
    steady = {name: f"{value}x3" for name, value in series.items()}
    check_queries(promtool, tmp_path, [], [(steady, asked, "20s", samples)])


ALERTS: Mapping[str, Mapping[str, str]] = {
    "TwindMetricsDown": {'up{job="twind", instance="r"}': "0x30"},
    "TwindDown": {'twind_up{instance="r"}': "0x30"},
    "TwindFault": {'twind_state{instance="r", twind_state="fault"}': "1x30"},
    "TwindEStop": {'twind_state{instance="r", twind_state="estop"}': "1x30"},
    "TwindActuatorFault": {'twind_joint_fault{instance="r", joint="a", fault="overload"}': "1x30"},
    "TwindHardwareLost": {
        'twind_hardware_connected{instance="r"}': "0x30",
        'twind_mode{instance="r", twind_mode="sim"}': "0x30",
    },
    "TwindJointStale": {
        'twind_joint_age_seconds{instance="r", joint="a"}': "0.2x30",
        'twind_hardware_connected{instance="r"}': "1x30",
    },
    "TwindJointSilent": {
        'twind_joint_heard{instance="r", joint="a"}': "0x30",
        'twind_hardware_connected{instance="r"}': "1x30",
    },
    "TwindJointHot": {'twind_joint_temperature_celsius{instance="r", joint="a"}': "66x30"},
    "TwindVoltage": {'twind_joint_voltage_volts{instance="r", joint="a"}': "10.9x30"},
    "TwindBusErrors": {
        'twind_bus_errors_total{instance="r", bus="main"}': "0+20x30",
        'twind_bus_exchanges_total{instance="r", bus="main"}': "0+1000x30",
    },
    "TwindMissedTicks": {'twind_loop_missed_ticks_total{instance="r"}': "0+1x30"},
    "TwindLate": {'twind_loop_on_time_ratio{instance="r"}': "0.9x30"},
    "TwindLatency": {
        'twind_latency_seconds_bucket{instance="r", hop="total", le="0.05"}': "0+90x30",
        'twind_latency_seconds_bucket{instance="r", hop="total", le="0.1"}': "0+100x30",
        'twind_latency_seconds_bucket{instance="r", hop="total", le="+Inf"}': "0+100x30",
    },
    "TwindReacted": {'twind_events_total{instance="r", code="OVERTEMP"}': "0x19 1x10"},
    "TwindTorqueInherited": {'twind_torque_inherited{instance="r"}': "1x30"},
}
CALM: Mapping[str, str] = {  # a robot that is well, or is simulated
    'up{job="twind", instance="r"}': "1x30",
    'twind_up{instance="r"}': "1x30",
    'twind_state{instance="r", twind_state="fault"}': "0x30",
    'twind_hardware_connected{instance="r"}': "0x30",
    'twind_mode{instance="r", twind_mode="sim"}': "1x30",
    'twind_joint_age_seconds{instance="r", joint="a"}': "0.02x30",
    'twind_joint_temperature_celsius{instance="r", joint="a"}': "60x30",
    'twind_joint_voltage_volts{instance="r", joint="a"}': "12x30",
    'twind_bus_errors_total{instance="r", bus="main"}': "0+1x30",
    'twind_bus_exchanges_total{instance="r", bus="main"}': "0+1000x30",
    'twind_loop_missed_ticks_total{instance="r"}': "0x30",
    'twind_loop_on_time_ratio{instance="r"}': "1x30",
    'twind_events_total{instance="r", code="OVERTEMP"}': "0x30",
    'twind_torque_inherited{instance="r"}': "0x30",
}


def test_every_alert_goes_off_for_what_it_names_and_none_for_a_robot_that_is_well(
    promtool: str, tmp_path: Path
) -> None:
    rules = yaml.safe_load((FILES / "twind.rules.yml").read_text())
    alerts = [rule["alert"] for group in rules["groups"] for rule in group["rules"]]
    assert set(alerts) == set(ALERTS)
    query = "count by (alertname) (ALERTS{alertstate='firing'})"
    fired = [(series, {f'{{alertname="{name}"}}': 1.0}) for name, series in ALERTS.items()]
    cases = [(series, query, "4m", samples) for series, samples in [(CALM, {}), *fired]]
    check_queries(promtool, tmp_path, [str(FILES / "twind.rules.yml")], cases)


# ------------------------------------------------------------------------------------------------ where


@pytest.mark.parametrize(
    ("remedy", "places"),
    [
        ("ssh -L", ["0.0.0.0:9797", "192.168.1.7:9797", "[::]:9797", "127.0.0.1:70000"]),
        ("write it as", ["9797", "robot:9797", "127.0.0.1", "127.0.0.1:http"]),
    ],
)
def test_a_remote_or_invalid_address_is_refused_with_a_remedy(remedy: str, places: Sequence[str]) -> None:
    for place in places:
        with pytest.raises(UsageError, match=remedy):
            metrics.loopback(place)


def test_a_port_that_is_taken_is_named() -> None:
    with metrics.loopback("localhost:0") as first:
        first.listen()
        with pytest.raises(Rejected, match="in use; name another"):
            metrics.loopback(f"127.0.0.1:{first.getsockname()[1]}")


def test_a_unix_socket_is_group_accessible_and_replaces_only_a_dead_one(tmp_path: Path) -> None:
    path = tmp_path / "metrics.sock"
    metrics.unix(str(path)).close()  # its file stays, as after SIGKILL
    with metrics.unix(str(path)) as served:
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
        served.listen()
        with pytest.raises(Rejected, match="a program serves it"):
            metrics.unix(str(path))
    path.unlink()
    path.write_text("mine")
    with pytest.raises(Rejected, match="something else"):
        metrics.unix(str(path))
    assert path.read_text() == "mine"
    assert not isinstance(served, str) and served.family == socket.AF_UNIX


def test_a_socket_that_is_not_ours_to_touch_is_named_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as datagrams:
        datagrams.bind(str(other))
        with pytest.raises(Rejected, match=r"other\.sock: Protocol wrong type for socket; name another"):
            metrics.unix(str(other))
    with pytest.raises(Rejected, match="Not a directory; name another"):
        metrics.unix(str(other / "metrics.sock"))

    def refuse(path: str) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr(os, "unlink", refuse)  # a dead socket in somebody else's folder; root may do all
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "dead.sock"))
    with pytest.raises(Rejected, match=r"dead\.sock: Permission denied; name another"):
        metrics.unix(str(tmp_path / "dead.sock"))


@pytest.mark.parametrize("option", ["--unix", "--listen"])
def test_an_empty_place_is_refused_and_not_the_usual_one(option: str) -> None:
    """A variable of a script that is not set must not open a port that all users may read."""
    parser = argparse.ArgumentParser()
    metrics.add_arguments(parser)
    with pytest.raises(UsageError, match="empty; name a path"):
        metrics.run(parser.parse_args([option, ""]))
