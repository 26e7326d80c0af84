"""Factory of family codecs for actuators of one bus, by the names of family and models. Pure."""

from collections.abc import Sequence

from twind_drivers.can.actuator_family import ActuatorFamily, FieldRanges
from twind_drivers.can.can_models import CanActuatorModel, model
from twind_drivers.can.cubemars_codec import CubeMarsCodec
from twind_drivers.can.damiao_codec import DamiaoCodec
from twind_drivers.can.id_lookup import column
from twind_drivers.can.odrive_codec import ODriveCodec
from twind_drivers.can.robstride_codec import RobStrideCodec

FAMILIES = ("damiao", "cubemars", "robstride", "odrive")
MASTER_BESIDE = 0x10  # Damiao's habit: an actuator speaks on its id and this
FIRST_BOARD = "ODrive"  # 3.x; later boards have a suffix


def make(
    family: str,
    port_name: str,
    ids: Sequence[int],
    models: Sequence[str],
    *,
    ranges: FieldRanges | None = None,
    feedback_ids: Sequence[int] | None = None,
    host: int = 0xFD,
) -> ActuatorFamily:
    """Make the codec of the actuators `ids` (k,), all of `family`, in that order.

    `ranges` None: those of the models. `feedback_ids` (k,): Damiao's master ids, None: id + 10h. `host`: the
    host id in RobStride frames. Raises KeyError for an unknown family or model; ValueError for ids with the
    same frame ids, a model of another family, or a range that neither robot file nor table gives.
    """
    if family not in FAMILIES:
        raise KeyError(f"no CAN family {family!r}: known are {', '.join(FAMILIES)}")
    if len(ids) != len(models):
        raise ValueError(f"{port_name}: {len(models)} models for {len(ids)} {family} actuators")
    known = [model(name) for name in models]
    for id, one in zip(ids, known, strict=True):
        if one.family != family:
            raise ValueError(f"{port_name}: id {id} is a {one.name}, which is {one.family}, not {family}")
    spans = ranges if ranges is not None else ranges_of(known)
    if family == "damiao":
        masters = feedback_ids if feedback_ids is not None else [id + MASTER_BESIDE for id in ids]
        return DamiaoCodec(port_name, ids, spans, masters)
    if family == "cubemars":
        return CubeMarsCodec(port_name, ids, spans)
    if family == "robstride":
        return RobStrideCodec(port_name, ids, spans, host)
    return ODriveCodec(port_name, ids, spans, [one.name != FIRST_BOARD for one in known])


def ranges_of(models: Sequence[CanActuatorModel]) -> FieldRanges:
    """Return the field ranges of the models (k,) from the table; NaN where it has none."""
    return FieldRanges(
        position=column([one.position for one in models]),
        velocity=column([one.velocity for one in models]),
        torque=column([one.torque for one in models]),
        kp=column([one.kp for one in models]),
        kd=column([one.kd for one in models]),
    )


def apart(port_name: str, families: Sequence[ActuatorFamily]) -> None:
    """Raise ValueError, naming it, for a frame id that two families of one bus use.

    An ODrive takes 32 ids from 20h times its node, so node 0 is among the ids of Damiao and CubeMars.
    """
    for place, one in enumerate(families):
        for other in families[place + 1 :]:
            shared = sorted(one.claims & other.claims)
            if shared:
                raise ValueError(
                    f"{port_name}: {one.name} {list(one.ids)} and {other.name} {list(other.ids)} both use "
                    f"frame id {shared[0]:#x}: give one of them other ids, or a bus of its own"
                )
