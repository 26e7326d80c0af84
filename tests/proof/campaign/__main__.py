"""`make proof [SUBJECT=…] [HOURS=…]`: run the harnesses on, piece by piece, up to the goals of this version.

Prints first how many hours each subject needs. A run that is interrupted goes on with the same inputs. One
that fails rests until the next run. `--again` repeats the commands that failed; those that pass are mended.
"""

import argparse
import fcntl
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from tests.proof.campaign import totals as t
from tests.proof.campaign.subjects import SUBJECTS, CampaignSubject
from twind.config.doc_pages import rewrite_page

ROOT = Path(__file__).parents[3]


def measured(pattern: str, output: str) -> float:
    """The sum of the numbers that the pattern finds; without a group, how often it is found."""
    found = re.findall(pattern, output) if pattern else []
    return sum(float(each) for each in found) if re.compile(pattern).groups else float(len(found))


def output_of(command: str, longest: float) -> tuple[int, str]:
    """Exit code and output of a harness. One that hangs for `longest` seconds is killed with its children."""
    whole = [sys.executable, "-m", *shlex.split(command)]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        whole, cwd=ROOT, stdout=pipe, stderr=subprocess.STDOUT, text=True, process_group=0
    ) as ran:
        try:
            output, _ = ran.communicate(timeout=longest)
        except subprocess.TimeoutExpired:
            os.killpg(ran.pid, signal.SIGKILL)
            output, _ = ran.communicate()
        except BaseException:
            os.killpg(ran.pid, signal.SIGKILL)
            raise
        return ran.returncode, output


def add(total: t.SubjectTotal, subject: CampaignSubject, count: float, run: tuple[int, str]) -> bool:
    """Add a piece of `count` inputs that began at `total.next`; whether all of it passed."""
    code, output = run
    broken = measured(subject.broken, output)
    total.passed += max(0.0, measured(subject.checked, output) - broken)
    good = code == 0 and not broken and measured(subject.checked, output) > 0
    if not good:
        total.failed += max(1.0, broken)
        total.open.append(subject.command.format(count=count, next=total.next))
    for name, number in re.findall(subject.parts, output) if subject.parts and good else ():
        total.parts[name] = round(total.parts.get(name, 0.0) + float(number), 3)
    following = int(measured(subject.following, output))
    total.next = following or total.next + (int(count) if subject.following else 1)
    return good


def saved(all_totals: list[t.SubjectTotal]) -> None:
    """Write the totals and their table."""
    t.write(all_totals)
    rewrite_page(t.PAGE, lambda page: t.page_with_totals(page, all_totals))


def commit() -> str:
    """The commit of these sources; "-dirty" where a file but the totals and their page differs from it."""
    ours = [f":(exclude){path.relative_to(ROOT)}" for path in (t.TOTALS, t.PAGE)]
    git = ["git", "-C", str(ROOT)]
    head = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ".", *ours], check=False).returncode
    return head.stdout.strip() + ("-dirty" if changed else "")


def piece(all_totals: list[t.SubjectTotal], name: str) -> bool:
    """Run the next piece of a subject and note it; whether all of it passed."""
    subject = SUBJECTS[name]
    total = t.of(all_totals, name)
    count = min(subject.piece, subject.goal - total.passed)
    begun = time.monotonic()
    run = output_of(subject.command.format(count=count, next=total.next), subject.longest)
    total.seconds = round(total.seconds + time.monotonic() - begun, 1)
    good = add(total, subject, count, run)
    total.commit = commit()
    total.date = datetime.now(UTC).date().isoformat()
    saved(all_totals)
    print(
        f"{name}: {total.passed:.10g} of {subject.goal:g} {subject.unit}, {total.failed:g} failed", flush=True
    )
    if not good:
        print(f"{run[1][-4000:]}\n{name} FAILED: {total.open[-1]}", flush=True)
    return good


def again(all_totals: list[t.SubjectTotal]) -> int:
    """Repeat what failed and is open; how many still fail."""
    for total in all_totals:
        for command in list(total.open):
            code, output = output_of(command, SUBJECTS[total.subject].longest)
            print(
                f"{'mended' if code == 0 else 'fails still'}: {command}\n{output if code else ''}", flush=True
            )
            if code == 0:
                total.open.remove(command)
                total.mended.append(command)
    saved(all_totals)
    return sum(len(total.open) for total in all_totals)


def campaign(all_totals: list[t.SubjectTotal], names: list[str], hours: float) -> set[str]:
    """Run pieces until the goals or the hours are reached; the subjects that failed."""
    for name in names:
        left = t.hours_left(t.of(all_totals, name))
        print(f"{name}: {'unknown' if left is None else f'{left:.1f}'} hours to the goal", flush=True)
    end = time.monotonic() + 3600.0 * hours
    failed: set[str] = set()
    while due := {name for name in names if t.of(all_totals, name).passed < SUBJECTS[name].goal} - failed:
        for name in (each for each in names if each in due):
            if time.monotonic() >= end:
                return failed
            if not piece(all_totals, name):
                failed.add(name)
    return failed


def main(arguments: list[str]) -> int:
    """Exit code 0: nothing failed."""
    parser = argparse.ArgumentParser(prog="make proof", description=__doc__)
    parser.add_argument("--subject", choices=SUBJECTS, action="append", help="default: all")
    parser.add_argument("--hours", type=float, default=float("inf"), help="begin no piece after so long")
    parser.add_argument("--again", action="store_true", help="repeat only what failed")
    asked = parser.parse_args(arguments)
    with Path(__file__).open() as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            parser.error("another campaign writes the totals of these sources: wait until it has ended")
        all_totals = t.read()
        if asked.again:
            return int(again(all_totals) > 0)
        return int(bool(campaign(all_totals, asked.subject or list(SUBJECTS), asked.hours)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
