"""A RobStride tells the number of its processor: two of one model with one id are told apart by it."""

from tests.support.can_driver_rig import CanRig
from twind_drivers.can.can_twin import default_node, identity
from twind_drivers.virtual.can.node_spec import NodeSpec


def test_an_actuator_that_reports_a_chip_number_has_it_as_its_unique_id() -> None:
    rig = CanRig(("RS01", "DM4310", "RS02"))
    first, second, third = rig.identify()
    assert second.unique_id is None
    assert {len(first.unique_id or ""), len(third.unique_id or "")} == {16}
    assert first.unique_id != third.unique_id
    assert first.unique_id == f"{NodeSpec(first.id, 'RS01').number:016x}"


def test_the_unique_id_in_a_fitting_calibration_equals_the_one_on_the_wire() -> None:
    rig = CanRig(("RS01",))
    assert identity(default_node(1, "RS01")).unique_id == rig.identify()[0].unique_id
    assert identity(default_node(1, "DM4310")).unique_id is None


def test_a_replacement_actuator_has_a_different_unique_id() -> None:
    assert f"{NodeSpec(1, 'RS01', chip=0xDEADBEEF00000001).number:016x}" == "deadbeef00000001"
    assert NodeSpec(1, "RS01").number != NodeSpec(1, "RS01", chip=77).number
