"""Subjects of the campaign: the command of each harness, numbers of its inputs, counts in its output."""

from dataclasses import dataclass

SEED = 28  # of the harnesses that number their inputs; the others take one seed for each piece


@dataclass(frozen=True)
class CampaignSubject:
    """One harness with one kind of input.

    `command` holds `{count}` and `{next}`. Of each pattern the numbers in its group are summed up over the
    output; a pattern without a group counts its matches. Without `following` the next piece has the next
    seed.
    """

    name: str
    unit: str
    command: str
    checked: str  # pattern: inputs that were tried; without `broken`: those that passed
    piece: float  # inputs of one run, some minutes
    goal: float  # inputs of a version
    broken: str = ""  # pattern: those that failed; an exit code that is not 0 counts as one at least
    following: str = ""  # pattern: the first number of the next piece
    parts: str = ""  # pattern: name and number of each part of a piece that passed
    longest: float = 3600.0  # s; a piece that takes longer hangs, and has failed


_KILL = r"(?m)^ *\d+ \w+ +\+[\d.]+ s: trip"


def _fuzz(what: str, piece: int, goal: float, unit: str = "inputs", parts: str = "") -> CampaignSubject:
    return CampaignSubject(
        f"fuzz-{what}",
        unit,
        f"tests.proof.fuzz --what {what} -n {{count:.0f}} --seed {SEED} --first {{next}}",
        rf"{what}: (\d+) inputs of seed",
        piece,
        goal,
        broken=r"(\d+) broke",
        following=r"next FIRST=(\d+)",
        parts=parts,
    )


SUBJECTS = {
    subject.name: subject
    for subject in (
        _fuzz("wire", 200_000, 1e8),
        _fuzz("checksum", 200_000, 1e8),
        _fuzz("can", 10_000_000, 1e9, "frames", r"(\w+) (\d+) frames"),
        _fuzz("frames", 20_000, 1e7),
        _fuzz("files", 2_000, 1e6),
        _fuzz("settings", 20_000, 1e6),
        _fuzz("cards", 20_000, 1e6),
        _fuzz("recordings", 500, 1e6),
        CampaignSubject(
            "oracle",
            "trajectories",
            f"tests.proof.oracle -n {{count:.0f}} --seed {SEED} --first {{next}}",
            r"(\d+) trajectories in",
            20_000,
            1e6,
            broken=r"(\d+) false accepts",
            following=r"next FIRST=(\d+)",
        ),
        CampaignSubject(
            "faults",
            "injections",
            "tests.proof.faults.run --number {count:.0f} --first {next}",
            r"(\d+) injections,",
            1,
            10_000,
            broken=r"injections, (\d+) wrong",
            following=r"next FIRST=(\d+)",
        ),
        CampaignSubject(
            "kills", "kills", "tests.support.sigkill_runs {count:.0f} --seed {next}", _KILL, 20, 200
        ),
        CampaignSubject(
            "lead-kills",
            "kills",
            "tests.support.unwatched_kills {count:.0f} --seed {next}",
            r"(?m)^ *\d+ UnwatchedKill\(",
            20,
            200,
        ),
        CampaignSubject(
            "model",
            "histories",
            "tests.proof.model {count:.0f} --seed {next}",
            r"(\d+) lives, no invariant broken",
            100,
            10_000,
        ),
        CampaignSubject(
            "soak",
            "h of virtual time",
            "tests.proof.soak.run --hours {count:g} --seed {next}",
            r"passed: ([\d.]+) h",
            0.5,  # memory is judged over a piece
            72,
            parts=r'"robot": "([\w-]+)",\s+"hours": ([\d.]+)',
            longest=3 * 3600.0,
        ),
        CampaignSubject(
            "storm",
            "min of real processes",
            "tests.proof.soak.run --real --minutes {count:g} --seed {next}",
            r"passed: ([\d.]+) min",
            30,  # in one piece
            30,
        ),
    )
}
