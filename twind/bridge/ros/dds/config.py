"""Where Cyclone DDS looks for others, as XML of its own configuration. Pure."""

from __future__ import annotations

from twind.bridge.ros.discovery import Discovery, Range

PARTICIPANTS = 120  # of one domain on one machine: as many as its 250 ports are enough for
HERE = "127.0.0.1"
_LOOPBACK = f'<NetworkInterface address="{HERE}" multicast="false"/>'


def configuration(discovery: Discovery, own: str = "") -> str | None:
    """What a domain is made with; None: the library's own way. `own`: what CYCLONEDDS_URI says.

    A user's own configuration is obeyed where others are looked for beyond this machine, not within it: it
    names the interface of a network, and who asked for this machine alone must not end there.
    """
    if discovery.range is Range.SYSTEM_DEFAULT:
        return own or None
    general, looking = "", ""
    if discovery.range is not Range.SUBNET:
        general += "<AllowMulticast>false</AllowMulticast>"
    if discovery.local:
        general += f"<Interfaces>{_LOOPBACK}</Interfaces>"
    if discovery.range is Range.OFF:
        looking = "<ParticipantIndex>none</ParticipantIndex>"  # no port that others know
    else:
        looking = f"<ParticipantIndex>auto</ParticipantIndex>{_limit()}{_peers(discovery)}"
    ours = (
        '<CycloneDDS><Domain id="any">'
        f"<General>{general}</General><Discovery>{looking}</Discovery>"
        "</Domain></CycloneDDS>"
    )
    return ours if discovery.local or not own else f"{ours},{own}"


def _limit() -> str:
    return f"<MaxAutoParticipantIndex>{PARTICIPANTS - 1}</MaxAutoParticipantIndex>"


def _peers(discovery: Discovery) -> str:
    here = () if discovery.range is Range.SUBNET else (HERE,)
    peers = "".join(f'<Peer address="{peer}"/>' for peer in (*here, *discovery.peers))
    return f"<Peers>{peers}</Peers>" if peers else ""
