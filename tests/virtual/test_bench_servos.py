from pathlib import Path

import pytest

from twind.config.robot_file import load_robot
from twind.exceptions import InvalidInput
from twind.virtual.bench_servos import bench, by_bus, servo
from twind.virtual.virtual_main import main
from twind.virtual.virtual_robot_spec import buses, make_spec
from twind.virtual.virtual_twin import BusTiming, DeviceOptions
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import Framer
from twind_drivers.dynamixel.servo_twin import settings
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.virtual_servos import ServoSpec


def test_a_servo_is_named_by_bus_id_model_and_firmware() -> None:
    assert servo("arm:3:XL330-M288") == ("arm", ServoSpec(3, "XL330-M288", {}, 47))
    assert servo("arm:3:XM430-W350:44") == ("arm", ServoSpec(3, "XM430-W350", {}, 44))
    assert servo("arm:3:XM430-W350", DeviceOptions(firmware=42))[1].firmware == 42


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("arm:3", "BUS:ID:MODEL"),
        ("arm::XM430-W350", "BUS:ID:MODEL"),
        ("arm:253:XM430-W350", r"253 is not one of 0\.\.252"),
        ("arm:-1:XM430-W350", "id -1"),
        ("arm:²:XM430-W350", "id ²"),
        ("arm:3:XM430-W351", "XM430-W350"),
        ("arm:3:XM430-W350:x", "firmware x"),
        ("arm:3:XM430-W350:256", "firmware 256"),
    ],
)
def test_an_invalid_servo_option_is_refused_with_the_expected_form(text: str, says: str) -> None:
    with pytest.raises(InvalidInput, match=says):
        servo(text)


def test_on_a_bench_servos_are_as_from_the_factory() -> None:
    """e-manual, XM430-W350: "Baud Rate" 57600, "Return Delay Time" 500 us."""
    (bus,) = bench([servo("arm:3:XM430-W350"), servo("arm:7:XL330-M288")], BusTiming()).values()
    bus.receive(packet.ping(3), 0.0)
    assert bus.next_output_time() == pytest.approx(24 * 10 / 57600 + 500e-6)
    assert [each.id for each in Framer(status=True).feed(bus.take(1.0))] == [3]


def test_given_settings_are_in_the_registers_and_the_adapter_options_apply() -> None:
    made = [
        (bus, ServoSpec(spec.id, spec.model, settings(1_000_000, 20)))
        for bus, spec in [servo("a:1:XM430-W350")]
    ]
    line = BusTiming(adapter=SerialAdapter(echo=True), wire_timing=False)
    (bus,) = bench(made, line, baud=1_000_000).values()
    assert (bus.servos["baud_rate"][0], bus.servos["return_delay_time"][0]) == (3, 10)
    bus.receive(packet.ping(1), 0.0)
    assert bus.take(0.0).startswith(packet.ping(1))


@pytest.mark.parametrize("register", [(120, 2), (132, 4)])
def test_two_servos_of_one_id_differ_in_tick_and_position_bits(register: tuple[int, int]) -> None:
    """Else no scan could tell that there are two: where the bits of both agree the line shows just that."""
    for seed in range(20):
        named = [servo("arm:3:XM430-W350"), servo("arm:3:XM430-W350")]
        (bus,) = bench(named, BusTiming(seed=seed)).values()
        bus.receive(packet.read(3, *register), 5.0)
        assert Framer(status=True).feed(bus.take(6.0)) == []


def test_the_same_seed_lays_the_same_servos_out() -> None:
    named = [servo(f"arm:{id}:XM430-W350") for id in (3, 3, 7)]

    def laid(seed: int) -> tuple[list[float], list[float]]:
        (bus,) = bench(named, BusTiming(seed=seed)).values()
        return bus.servos.muscles.position.tolist(), bus.servos.readings.origin.tolist()

    assert laid(1) == laid(1)
    assert laid(1) != laid(2)
    ticks, since = laid(1)
    assert len(set(ticks)) == len(set(since)) == 3
    assert all(1648 <= tick <= 2448 for tick in ticks)
    assert all(-20.0 < at <= 0.0 for at in since)


def test_a_servo_beside_a_robots_with_the_same_id_is_a_twin() -> None:
    made = make_spec(load_robot("h24"))
    extra = by_bus([("main", ServoSpec(7, "XM430-W350", settings(made.robot.bus("main").baud, 400)))])
    bus = buses(made, physics=False, extra=extra)["main"]
    bus.receive(packet.read(7, 0, 2), 0.0)
    assert [each.id for each in Framer(status=True).feed(bus.take(1.0))] == [7, 7]


def test_an_extra_servo_that_does_not_fit_the_robot_is_refused() -> None:
    made = make_spec(load_robot("h24"))
    with pytest.raises(InvalidInput, match="no bus 'left'; h24 has main"):
        buses(made, physics=False, extra={"left": [ServoSpec(1)]})
    with pytest.raises(InvalidInput, match="first-order"):
        buses(made, extra={"main": [ServoSpec(1)]})


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--latency-timer", "nan"], "0..255 ms"),
        (["--latency-timer", "300"], "0..255 ms"),
        (["--firmware", "256"], "0..255"),
        (["--seed", "-1"], "0 or more"),
        (["--servo", "a:1:XM430-W350", "--calibration", "x.yaml"], "needs --robot"),
        (["--servo", "a:1:XL-999"], "XL"),
        (["--servo", "a:1:XM430-W350", "--baud", "12345"], "9600"),
    ],
)
def test_options_that_no_adapter_or_servo_can_have_end_with_2(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(options) == 2
    assert says in capsys.readouterr().err
    assert not Path("x.yaml").exists()


def test_a_can_actuator_is_named_as_a_servo_is() -> None:
    virtual = bench([servo("leg:1:DM4340"), servo("leg:2:AK70-10"), servo("arm:3:ODrive")], BusTiming())
    assert {name: (bus.kind, bus.ids()) for name, bus in virtual.items()} == {
        "leg": ("can", [1, 2]),
        "arm": ("can", [3]),
    }
    places = [told["position"] for told in virtual["leg"].truth(0.0)]
    assert len(set(places)) == 2
    assert places == [
        told["position"]
        for told in bench([servo("leg:1:DM4340"), servo("leg:2:AK70-10")], BusTiming())["leg"].truth(0.0)
    ]


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["leg:128:DM4340"], "id 128 is not one of 0..127"),
        (["leg:64:ODrive"], "id 64 is not one of 0..63"),
        (["leg:1:DM4340:2"], "has no firmware to choose"),
        (["leg:1:DM4340", "leg:2:XM430-W350"], "bus leg: DM4340 and XM430-W350 cannot share a wire"),
    ],
)
def test_a_can_actuator_that_cannot_be_is_refused(texts: list[str], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        bench([servo(text) for text in texts], BusTiming())
