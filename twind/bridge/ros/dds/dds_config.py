"""Discovery configuration of Cyclone DDS, as XML."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from twind.bridge.ros.discovery import DiscoveryRange, DiscoverySettings
from twind.bridge.ros.ros_trajectory import LONGEST
from twind.exceptions import OperationFailed

HERE = "127.0.0.1"
# The library drops a sample that is longer than any message of the bridge and logs it. The linger duration is
# how long each closed writer waits for readers that do not answer; the default is 1 s.
_LIMITS = (
    f"<Internal><MaxSampleSize>{LONGEST + 4096} B</MaxSampleSize>"
    "<WriterLingerDuration>20 ms</WriterLingerDuration></Internal>"
)
# ROS elsewhere on this machine, with its own range SUBNET, listens here but looks for others by multicast
# alone: it is found when it receives an announcement, by default each 30 s, and later never again.
_OFTEN = "<SPDPInterval>1 s</SPDPInterval>"
_FOR_EVER = "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
_LOOPBACK = f'<NetworkInterface address="{HERE}" multicast="false"/>'
# Ports of a domain by RTPS 9.6.1: 250 for each, of which each participant has two, from the eleventh on.
_FIRST_PORT = 7400
_PORTS = 250
_FIRST = 10
_EACH = 2
_LAST_PORT = 65535


def configuration(discovery: DiscoverySettings, own: str = "") -> str | None:
    """Return the configuration of a domain; None: the library's own. `own`: value of CYCLONEDDS_URI.

    A user's own configuration is obeyed where others are looked for beyond this machine, not within it: it
    names the interface of a network, and who asked for this machine alone must not end there.
    Raises OperationFailed: a peer that has no address.
    """
    if discovery.range is DiscoveryRange.SYSTEM_DEFAULT:
        return own or None
    general = ""
    looking = ""
    if discovery.range is not DiscoveryRange.SUBNET:
        general += "<AllowMulticast>false</AllowMulticast>"
    if discovery.local:
        general += f"<Interfaces>{_LOOPBACK}</Interfaces>"
    if discovery.range is DiscoveryRange.OFF:
        looking = "<ParticipantIndex>none</ParticipantIndex>"  # no port that others expect
    else:
        last = participants(discovery.domain) - 1
        looking = "<ParticipantIndex>auto</ParticipantIndex>"
        looking += f"<MaxAutoParticipantIndex>{last}</MaxAutoParticipantIndex>{_peers(discovery)}"
        looking += _FOR_EVER + (_OFTEN if discovery.local else "")
    settings = (
        '<CycloneDDS><Domain id="any">'
        f"<General>{general}</General><Discovery>{looking}</Discovery>{_LIMITS}"
        "</Domain></CycloneDDS>"
    )
    return settings if discovery.local or not own else f"{settings},{own}"


def participants(domain: int) -> int:
    """Return how many participants of one domain fit on one machine: as many as have ports."""
    first = _FIRST_PORT + _PORTS * domain + _FIRST
    end = min(first - _FIRST + _PORTS, _LAST_PORT + 1)
    return (end - first) // _EACH


def _peers(discovery: DiscoverySettings) -> str:
    here = () if discovery.range is DiscoveryRange.SUBNET else (HERE,)
    peers = "".join(f'<Peer address="{each}"/>' for each in (*here, *_addresses(discovery.peers)))
    return f"<Peers>{peers}</Peers>" if peers else ""


def _addresses(peers: Sequence[str]) -> list[str]:
    """IPv4 addresses of names: the library ends the whole process at a name that it cannot resolve."""
    found = []
    for peer in peers:
        try:
            found.append(socket.getaddrinfo(peer, None, socket.AF_INET)[0][4][0])
        except (OSError, UnicodeError) as error:
            raise OperationFailed(f"dds: ROS_STATIC_PEERS: {peer}: {error}") from None
    return list(dict.fromkeys(map(str, found)))
