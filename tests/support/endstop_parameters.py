"""Parameters of an end-stop search."""

from twind.motion.endstop_search import HomingParameters

TICK = 0.01  # s
RAD = 4096 / 6.283185
SEARCH = HomingParameters(
    way=1,
    expected=3000.0,
    margin=0.2 * RAD,
    speed=0.2 * RAD,
    cap=100.0,
    back=0.1 * RAD,
    lead=0.2 * RAD,
    astray=0.15 * RAD,
    still=2.0,
    times=3,
)
