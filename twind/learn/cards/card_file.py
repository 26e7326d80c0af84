"""A policy file of any origin: with the card of `twindctl train`, or with a card of another framework.

As in `policy_file.py` a network first runs in a process of its own: `python -m twind.learn.cards.card_file`.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.interface_card import KEY, card_beside, parse_card, read_card
from twind.learn.policy import policy_file
from twind.learn.policy.onnx_session import OnnxSession
from twind.learn.policy.policy_file import Policy, check_stdin, network_bytes, require_runnable


def load_any(path: Path, card: Path | None = None) -> Policy | CardPolicy:
    """Return the policy of a file with its card: `card`, else the one beside it, else the one inside.

    Raises InvalidInput naming the file, ConfigError naming the card's line.
    """
    place = card or card_beside(path)
    text = read_card(place)[1] if card is not None or place.exists() else ""
    stored = path.with_name(f"{path.name}.data")  # where torch.onnx.export puts the weights
    try:
        beside = {stored.name: network_bytes(stored)} if stored.exists() else {}
        data = network_bytes(path)
        require_runnable(__name__, msgspec.msgpack.encode((data, beside, text)))
        return _policy(data, beside, text, str(place))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def _policy(data: bytes, beside: Mapping[str, bytes], text: str, file: str) -> Policy | CardPolicy:
    """Load a network and run it once. `text`: of its card, "": inside. Raises InvalidInput."""
    session = OnnxSession(data, beside)
    if not text and policy_file.KEY in session.metadata:
        return policy_file.from_session(session)
    if not text and KEY not in session.metadata:
        raise InvalidInput(
            f"has no card: no NAME.card.yaml beside it, no {policy_file.KEY!r} or {KEY!r} in its metadata: "
            "`twindctl policy card --template NAME` writes one to fill in"
        )
    try:
        made = parse_card(text or session.metadata[KEY], file if text else f"metadata {KEY}")
    except ConfigError as error:
        raise InvalidInput(str(error)) from None
    policy = CardPolicy(made, session)
    action = policy.act(policy.zeros())
    policy.begin()
    if not np.isfinite(action).all():
        joint = made.joints[int(np.argmin(np.isfinite(action)))]
        raise InvalidInput(
            f"its action of {joint} is not finite for an observation of zeros: check its weights"
        )
    return policy


def _check(stdin: bytes) -> None:
    data, beside, text = msgspec.msgpack.decode(stdin, type=tuple[bytes, dict[str, bytes], str])
    _policy(data, beside, text, "its card")


if __name__ == "__main__":
    sys.exit(check_stdin(_check))
