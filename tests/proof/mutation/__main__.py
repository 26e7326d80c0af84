"""`make mutate [FILES=…] [SAMPLE=…] [CHANGED=…] [SECONDS=…]`: does a test notice every small change?

A mutant that can be shown to change nothing that anybody sees is equivalent: it is listed, and not counted.
Fails when less than `ENOUGH` of the others are noticed, when one survives that survivors.toml does not list
with a reason, when one that it lists is noticed after all, or does not exist any more.
"""

import argparse
import hashlib
import json
import random
import subprocess
import sys
import time
import tomllib
from collections.abc import Collection
from functools import cache
from pathlib import Path

from tests.proof.mutation.mutant_runner import judge
from tests.proof.mutation.mutated_code import Case, cases_of
from tests.proof.mutation.rooms import HOME, Room, rooms_of

ENOUGH = 0.98
SEED = 4
LEDGER = Path(__file__).with_name("survivors.toml")
MEMORY = (
    HOME / ".mutation"
)  # a file of each room: who killed whom, as long as the module and that test stand as they were


def main(arguments: list[str]) -> int:
    """Exit code 0: all is as it should be."""
    parser = argparse.ArgumentParser(prog="make mutate", description=__doc__)
    parser.add_argument("files", nargs="*", help="rooms or modules; all where none is named")
    parser.add_argument("--sample", type=int, help="so many mutants of each room, chosen by a fixed seed")
    parser.add_argument("--changed", metavar="REV", help="only lines that differ from where REV branched off")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no mutant later")
    parser.add_argument("--list", action="store_true", help="only name the mutants")
    parser.add_argument("--brief", action="store_true", help="few generated examples, and no second try")
    parser.add_argument("--anew", action="store_true", help="believe no earlier run")
    options = parser.parse_args(arguments)
    begun = time.monotonic()
    fine = True
    reasons = ledger()
    chosen = [(room, _choose(modules, options)) for room, modules in rooms_of(options.files)]
    for place, (room, (cases, every)) in enumerate(chosen):
        if options.list:
            print(*(case.name for case in cases), sep="\n")
            continue
        left = options.seconds - (time.monotonic() - begun)
        share = left / (len(chosen) - place)  # what a room leaves over is the next one's
        judged = _judged(room, cases, reasons, time.monotonic() + share, options)
        whole = not (options.sample or options.changed)
        fine &= _report(room, judged, len(cases), every, reasons, whole, time.monotonic() - begun)
    return 0 if fine else 1


def ledger() -> dict[str, str]:
    """The survivors that are known: name -> reason."""
    groups = tomllib.loads(LEDGER.read_text()).get("group", [])
    return {name: f"{group['kind']}: {group['reason']}" for group in groups for name in group["mutants"]}


def _choose(modules: tuple[str, ...], options: argparse.Namespace) -> tuple[list[Case], list[Case]]:
    """The mutants to try, and all there are."""
    every = [case for module in modules for case in cases_of(module)]
    cases = every
    if options.changed:
        touched = {module: _touched(module, options.changed) for module in modules}
        cases = [case for case in every if case.mutant.line in touched[case.module]]
    if options.sample and len(cases) > options.sample:
        cases = random.Random(SEED).sample(cases, options.sample)
    return cases, every


def _touched(module: str, revision: str) -> set[int]:
    """Lines of `module` that differ from where the work branched off `revision`."""
    command = ["git", "diff", "-U0", "--merge-base", revision, "--", module]
    diff = subprocess.run(command, cwd=HOME, capture_output=True, text=True, check=True).stdout
    lines: set[int] = set()
    for row in diff.splitlines():
        if row.startswith("@@"):
            start, _, count = row.split("+")[1].split(" ")[0].partition(",")
            lines |= set(range(int(start), int(start) + int(count or 1)))
    return lines


def _judged(
    room: Room, cases: list[Case], listed: Collection[str], deadline: float, options: argparse.Namespace
) -> list[Case]:
    """Judge what no earlier run has settled: a kill holds as long as the module and the test that killed
    stand as they were, a survival as long as all tests of the room do."""
    memory = MEMORY / f"{room.name}.json"
    known = json.loads(memory.read_text()) if memory.exists() and not options.anew else {}
    MEMORY.mkdir(exist_ok=True)

    @cache
    def stamp(module: str, test: str) -> str:
        chosen = [HOME / each for each in ([test] if (HOME / test).is_file() else room.tests)]
        read = {file: file.read_bytes() for file in chosen if file.is_file()}
        named = b"".join(read.values())
        worlds = [
            file for file in sorted((HOME / "tests/support").glob("*_rig.py")) if file.stem.encode() in named
        ]
        stuff = [*(file.read_bytes() for file in (*worlds, HOME / module)), *read.values()]
        return hashlib.sha256(b"".join(stuff)).hexdigest()[:16]

    def remember(case: Case) -> None:
        killer = case.killer or ""
        known[case.name] = killer, stamp(case.module, killer.partition("::")[0])
        memory.write_text(json.dumps(known))

    fresh = []
    settled = []
    # In this order a run that is cut short is a fair sample.
    for case in random.Random(SEED).sample(cases, len(cases)):
        killer, stamped = known.get(case.name, ("", ""))
        if stamped == stamp(case.module, killer.partition("::")[0]):
            case.killer = killer or None
            case.covered = True
            settled.append(case)
        else:
            fresh.append(case)
    return settled + (judge(room, fresh, deadline, remember, listed, options.brief) if fresh else [])


def _report(
    room: Room,
    judged: list[Case],
    wanted: int,
    every: list[Case],
    reasons: dict[str, str],
    whole: bool,
    t: float,
) -> bool:
    """Says what came out; False where something is wrong."""
    alive = [case for case in judged if not case.killer]
    same = sum(reasons.get(case.name, "").startswith("equivalent") for case in alive)
    killed = len(judged) - len(alive)
    able = len(judged) - same
    rate = killed / able if able else 1.0
    note = "" if len(judged) == wanted else f" ({wanted - len(judged)} more for want of time)"
    print(
        f"{room.name}: {killed} of {len(judged)} mutants killed, {100.0 * rate:.2f} %{note}, {t:.0f} s",
        flush=True,
    )
    wrong = []
    for case in alive:
        if case.name not in reasons:
            wrong.append(f"survives{'' if case.covered else ', no test runs it'}: {case.name}")
    wrong += [
        f"listed, but killed by {case.killer}: {case.name}"
        for case in judged
        if case.killer and case.name in reasons
    ]
    names = {case.name for case in every}
    modules = {case.module for case in every}
    wrong += [
        f"listed, but not there: {name}"
        for name in reasons
        if name.partition("::")[0] in modules and name not in names
    ]
    if whole and rate < ENOUGH:
        wrong.append(f"fewer than {100.0 * ENOUGH:.0f} % killed")
    for line in wrong:
        print("  " + line)
    return not wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
