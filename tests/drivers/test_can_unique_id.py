"""A RobStride tells the number of its processor: two of one model with one id are told apart by it."""

from tests.support.can_driver_rig import CanRig
from twind.virtual.can_node_setup import default_node, device
from twind_drivers.virtual.can.node_spec import NodeSpec


def test_who_tells_a_number_has_it_as_its_unique_id_and_the_others_have_none() -> None:
    rig = CanRig(("RS01", "DM4310", "RS02"))
    first, second, third = rig.identify()
    assert second.unique_id is None
    assert {len(first.unique_id or ""), len(third.unique_id or "")} == {16}
    assert first.unique_id != third.unique_id
    assert first.unique_id == f"{NodeSpec(first.id, 'RS01').number:016x}"


def test_what_a_fitting_calibration_records_is_what_the_wire_tells() -> None:
    rig = CanRig(("RS01",))
    assert device(default_node(1, "RS01")).unique_id == rig.identify()[0].unique_id
    assert device(default_node(1, "DM4310")).unique_id is None


def test_one_that_was_put_in_its_place_has_another() -> None:
    assert f"{NodeSpec(1, 'RS01', chip=0xDEADBEEF00000001).number:016x}" == "deadbeef00000001"
    assert NodeSpec(1, "RS01").number != NodeSpec(1, "RS01", chip=77).number
