"""Facts from the scan of a port: ids, models and the baud rate of a bus."""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from twind.command_line.verb import Rejected
from twind_calibration.drafting.robot_draft import RobotDraft, protocol_of

SECONDS = 300.0  # of a scan of all ids at all rates


def announce(options: argparse.Namespace, port: str) -> None:
    """Say that a scan begins: a search of all ids at all rates is long."""
    if not options.json:
        print(f"scanning {port}: this may take a minute", file=sys.stderr, flush=True)


def scan_port(port: str) -> list[dict[str, Any]]:
    """Return the devices that `twindctl scan --port` finds. Raises Rejected: none, or a fault of the line."""
    return devices_of(*scan_rows(port), port)


def scan_rows(port: str, ids: range | None = None) -> tuple[list[dict[str, Any]], str]:
    """Return the lines of `twindctl scan --port`, and what it said. Raises Rejected where it does not end.

    `ids`: those that are searched; None: all.
    """
    command = [sys.executable, "-m", "twind.ctl.ctl_main", "--json", "scan", "--port", port]
    if ids is not None:
        command += ["--ids", f"{ids[0]}-{ids[-1]}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise Rejected(f"{port}: the scan did not end within {SECONDS:.0f} s") from None
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    refused = [row["parameters"]["message"] for row in rows if "error" in row]
    return rows, "; ".join(refused) or done.stderr.strip()


def require_devices(rows: list[dict[str, Any]], error: str, port: str) -> list[dict[str, Any]]:
    """Return the devices among the lines of a scan, faulty ones too. Raises Rejected where there is none."""
    devices = [row for row in rows if row.get("id") is not None]
    if not devices:
        said = [f"{row.get('baud')} baud: {row['trouble']}" for row in rows if row.get("trouble")]
        why = f"{port}: {'; '.join(said)}; correct it and scan again" if said else error
        raise Rejected(why or f"{port}: no device answers")
    return devices


def devices_of(rows: list[dict[str, Any]], error: str, port: str) -> list[dict[str, Any]]:
    """Return the devices among the lines of a scan. `error`: what the scan said where it found none.

    A trouble of the line alone, such as replies of another protocol, counts only where no device is found.
    Raises Rejected.
    """
    devices = require_devices(rows, error, port)
    troubles = [
        f"{row['baud']} baud, id {row['id']}: {row['trouble']}" for row in devices if row.get("trouble")
    ]
    if troubles:
        raise Rejected(
            f"{port}: {'; '.join(troubles)}; correct it, ids with `twindctl robot servo --port {port}`, and "
            "try again"
        )
    return devices


def require_one_bus(draft: RobotDraft, scans: Mapping[str, list[dict[str, Any]]]) -> None:
    """Raises Rejected for a joint of unknown bus whose id answers on several buses."""
    for joint in draft.joints.values():
        number = joint.get("id")
        buses = [bus for bus, devices in scans.items() if number in [int(each["id"]) for each in devices]]
        if joint.get("bus") is None and len(buses) > 1:
            raise Rejected(
                f"joint {joint.name}: id {number} answers on {' and '.join(buses)}: say "
                f"--bus {joint.name}=BUS"
            )


def fill_from_scan(
    draft: RobotDraft, bus: str, port: str, devices: list[dict[str, Any]], *, named: bool
) -> None:
    """State what the devices of a bus tell. A device without a joint becomes joint `BUS_ID`.

    `named`: other sources name the joints, so that such a device is worth a remark.

    Raises Rejected: two baud rates on one bus, or a device of an unknown model.
    """
    source = f"scan of {bus}"
    rates = sorted({int(each["baud"]) for each in devices})
    if len(rates) > 1:
        slow = ", ".join(
            f"id {each['id']} at {each['baud']}" for each in devices if each["baud"] != rates[-1]
        )
        raise Rejected(
            f"{port}: two baud rates on one bus: {slow}, others at {rates[-1]}; set one with "
            f"`twindctl robot servo --port {port} --baud {rates[-1]}`"
        )
    draft.bus(bus).state("port", port, source)
    draft.bus(bus).state("baud", rates[0], source)
    for each in devices:
        number = int(each["id"])
        model = each.get("model_name")
        if not model:
            raise Rejected(f"{port}: id {number} is model {each.get('model')}, which no driver knows")
        joint = draft.joint_of(bus, number)
        if joint is None:
            if named:
                draft.remarks.append(f"id {number} on {bus} ({model}) is no joint of the given files")
            joint = draft.joint(f"{bus}_{number}")
        joint.state("bus", bus, source)
        joint.state("id", number, source)
        joint.state("device", model, source)
        joint.state("protocol", protocol_of(model), source)
