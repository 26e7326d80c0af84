"""`twindctl calibrate scan`: the doctor's looks at buses and devices, and what a calibration records."""

import argparse
from collections.abc import Iterator

from twind.command_line.progress import ProgressLine
from twind.command_line.text_table import align_columns
from twind.command_line.verb import DONE, REFUSED, show
from twind.ctl.hint_options import command_hint
from twind.doctor import report, runner
from twind.doctor.check_context import CheckContext, examine
from twind.doctor.family_doctor import DeviceSurvey, doctors
from twind.doctor.host_inspector import HostInspector
from twind_drivers.clock import MonotonicClock

# Register -> heading; what a calibration records of a device.
SNAPSHOT = {
    "homing_offset": "homing",
    "drive_mode": "drive",
    "operating_mode": "mode",
    "min_position_limit": "min",
    "max_position_limit": "max",
}
BESIDE = (
    "a daemon asks for the ids of its robot file alone: unknown ids, and ids that answer twice, "
    "are found with the daemon stopped"
)


def scan(options: argparse.Namespace) -> int:
    """Exit code 0: no device has a fault. Raises UsageError."""
    known = runner.table()
    looks = [what for each in doctors() for what in each.at_calibration]
    checks = [each for each in runner.all_checks() if each.what in looks]
    examined = examine(options, HostInspector(), MonotonicClock())
    try:
        with ProgressLine(options, "scan") as progress:
            outcome = runner.run(examined, progress.each(checks, lambda check: check.what), known)
        beside = examined.daemon is not None
        here = command_hint(options, examined.sockets or None)
        outcome.found, outcome.fix = report.add_commands(outcome.found, known, here, daemon=beside)
        devices = list(_devices(examined))
    finally:
        examined.close()
    wrong = report.count_problems(outcome, known, None) + len(outcome.unseen) + len(examined.wrong_files)
    text = [*_table(devices), *(str(error) for error in examined.wrong_files)]
    text += [*([BESIDE] if beside else []), "", report.text(outcome, known, None)]
    data = report.data(outcome, known, None) | {"devices": devices}
    data["wrong_files"] = [str(error) for error in examined.wrong_files]
    show(options, data, "\n".join(text))
    return REFUSED if wrong or not devices else DONE


def _devices(checked: CheckContext) -> Iterator[dict[str, object]]:
    """Yield every device that answers, bus by bus, with the registers that were read."""
    for survey in checked.surveys.values():
        for device in survey.devices if isinstance(survey, DeviceSurvey) else ():
            yield {
                "bus": device.bus,
                "id": device.id,
                "joint": device.joint,
                "model": device.model,
                "firmware": device.firmware,
                **{name: device.values.get(name) for name in SNAPSHOT},
            }


def _table(devices: list[dict[str, object]]) -> list[str]:
    heads = ("bus", "id", "joint", "model", "firmware", *SNAPSHOT)
    rows = [tuple(SNAPSHOT.get(head, head) for head in heads)]
    rows += [tuple("-" if each[head] is None else str(each[head]) for head in heads) for each in devices]
    return align_columns(rows, left=(0, 2, 3))
