"""Robots of the roster for a viewer: names, and connections to each. Imports Zenoh for remote ones."""

from collections.abc import Mapping

from twind.bridge.fleet.client_sessions import SharedSession
from twind.bridge.fleet.fleet_monitor import FleetMonitor
from twind.bridge.fleet.fleet_roster import UPLINK, RobotRecord
from twind.bridge.fleet.remote_client import client
from twind.client import Client
from twind.observe.viewing.robot_connections import RobotConnections, local


def found(monitor: FleetMonitor) -> Mapping[tuple[str, str], RobotConnections]:
    """Return every robot that was ever present, by name and place."""
    ways = {(each.name, each.where): _ways(each, monitor.way) for each in monitor.roster.robots()}
    return {whose: way for whose, way in ways.items() if way is not None}


def _ways(robot: RobotRecord, shared: SharedSession | None) -> RobotConnections | None:
    """Return its connections; None: no joined network reaches it."""
    if robot.where != UPLINK:
        return local(robot.where)
    if shared is None:
        return None
    network = shared

    def way(patience: float) -> Client:
        connection = client(robot.name, network, patience)
        connection.connect()
        return connection

    return RobotConnections((way,), way)
