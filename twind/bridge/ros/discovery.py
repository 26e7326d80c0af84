"""Discovery settings of a ROS 2 graph, from the variables of ROS users. Pure; standard library, 3.10.

One difference to ROS: unset means this machine alone, where ROS from Iron on uses SUBNET. A robot that can be
commanded is not offered to a network because of a missing variable.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from twind.exceptions import InvalidInput

LAST_DOMAIN = 232  # the ports of a domain, 7400 + 250 each, end there
DISTRO = "jazzy"  # taken where none is named: all from Iron on are alike in what depends on it
_DISTRO = re.compile(r"[a-z]{2,32}")
_PEER = re.compile(r"[A-Za-z0-9_.:%-]{1,253}")  # names, IPv4, IPv6 with a zone; no more gets into a config


class DiscoveryRange(Enum):
    """Range of discovery, as in ROS_AUTOMATIC_DISCOVERY_RANGE."""

    OFF = "OFF"  # none: no packet leaves
    LOCALHOST = "LOCALHOST"  # this machine, and the peers that are named
    SUBNET = "SUBNET"  # nodes within reach of multicast, and the peers
    SYSTEM_DEFAULT = "SYSTEM_DEFAULT"  # the transport's own configuration


@dataclass(frozen=True, slots=True)
class DiscoverySettings:
    """Discovery settings of a back end."""

    domain: int = 0  # ROS_DOMAIN_ID, 0..232
    range: DiscoveryRange = DiscoveryRange.LOCALHOST
    peers: tuple[str, ...] = ()  # addresses or names of other machines, contacted by unicast
    distro: str = DISTRO  # of the peers: it determines the form of their graph messages

    @property
    def humble(self) -> bool:
        """Humble's graph: gids of 24 bytes, no type hashes. From Iron on 16 bytes and hashes."""
        return self.distro == "humble"

    @property
    def local(self) -> bool:
        """Return True if no packet leaves this machine."""
        return self.range is DiscoveryRange.OFF or (self.range is DiscoveryRange.LOCALHOST and not self.peers)


def discovery(
    environment: Mapping[str, str], *, domain: int | None = None, distro: str | None = None
) -> DiscoverySettings:
    """From an environment; `domain` and `distro` are options that come before it. Raises InvalidInput."""
    number = _domain(environment.get("ROS_DOMAIN_ID", "")) if domain is None else domain
    if not 0 <= number <= LAST_DOMAIN:
        raise InvalidInput(f"domain {number}: must be 0 to {LAST_DOMAIN}")
    name = (distro or environment.get("ROS_DISTRO", "") or DISTRO).strip().lower()
    if _DISTRO.fullmatch(name) is None:
        raise InvalidInput(f"ROS_DISTRO={name!r}: expected the name of a distribution, such as {DISTRO}")
    if _localhost_only(environment.get("ROS_LOCALHOST_ONLY", "")):
        return DiscoverySettings(
            number, DiscoveryRange.LOCALHOST, (), name
        )  # as in ROS: the other two do not count then
    return DiscoverySettings(number, _range(environment), _peers(environment), name)


def _domain(text: str) -> int:
    if not text:
        return 0
    if not (text.isascii() and text.isdigit()):
        raise InvalidInput(f"ROS_DOMAIN_ID={text!r}: must be a number, 0 to {LAST_DOMAIN}")
    return int(text[:9])


def _localhost_only(text: str) -> bool:
    if text not in ("", "0", "1"):
        raise InvalidInput(f"ROS_LOCALHOST_ONLY={text!r}: must be 0 or 1")
    return text == "1"


def _range(environment: Mapping[str, str]) -> DiscoveryRange:
    text = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or DiscoveryRange.LOCALHOST.value
    try:
        return DiscoveryRange(text)
    except ValueError:
        known = ", ".join(each.value for each in DiscoveryRange)
        raise InvalidInput(f"ROS_AUTOMATIC_DISCOVERY_RANGE={text!r}: must be one of {known}") from None


def _peers(environment: Mapping[str, str]) -> tuple[str, ...]:
    names = [each.strip() for each in environment.get("ROS_STATIC_PEERS", "").split(";")]
    peers = tuple(dict.fromkeys(each for each in names if each))
    for peer in peers:
        if _PEER.fullmatch(peer) is None:
            raise InvalidInput(f"ROS_STATIC_PEERS: {peer!r} is no address; several are parted by `;`")
    return peers
