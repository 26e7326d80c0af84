"""A policy file of any origin: with the card of `twindctl train`, or with a card of another framework.

As in `policy_file.py` a network first runs in a process of its own: `python -m twind.learn.cards.card_file`.
"""

import sys
from pathlib import Path

import numpy as np

from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.learn.cards.card_actor import CardPolicy
from twind.learn.cards.interface_card import KEY, card_beside, parse_card, read_card
from twind.learn.policy import policy_file
from twind.learn.policy.onnx_session import OnnxSession
from twind.learn.policy.policy_file import Policy, check_stdin, network_bytes, require_runnable

HEAD = 8  # bytes before the card that say its length


def load_any(path: Path, card: Path | None = None) -> Policy | CardPolicy:
    """Return the policy of a file with its card: `card`, else the one beside it, else the one inside.

    Raises InvalidInput naming the file, ConfigError naming the card's line.
    """
    place = card or card_beside(path)
    text = read_card(place)[1] if card is not None or place.exists() else ""
    try:
        data = network_bytes(path)
        require_runnable(__name__, len(text.encode()).to_bytes(HEAD, "big") + text.encode() + data)
        return _policy(data, text, str(place))
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def _policy(data: bytes, text: str, file: str) -> Policy | CardPolicy:
    """Load a network and run it once. `text`: of its card, "": inside. Raises InvalidInput."""
    session = OnnxSession(data)
    if not text and policy_file.KEY in session.metadata:
        return policy_file.from_session(session)
    if not text and KEY not in session.metadata:
        raise InvalidInput(
            f"has no card: neither {file} nor {policy_file.KEY!r} or {KEY!r} in its metadata: "
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
    end = HEAD + int.from_bytes(stdin[:HEAD], "big")
    _policy(stdin[end:], stdin[HEAD:end].decode(), "its card")


if __name__ == "__main__":
    sys.exit(check_stdin(_check))
