"""Print the completion script of a shell.

`make install` and the Debian package install these scripts. Elsewhere:
`twindctl completion bash > ~/.local/share/bash-completion/completions/twindctl`, and for zsh
`twindctl completion zsh > FOLDER/_twindctl` with a folder of $fpath. The scripts are static: Tab starts no
program of twind.
"""

import argparse

from twind.command_line.verb import DONE

group = "set up"
unused_options = ("--socket", "--json")  # it asks no daemon

SHELLS = ("bash", "zsh")
PROGRAMS = ("twindctl", "twind", "twind-virtual")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: the shell and the program."""
    parser.add_argument("shell", choices=SHELLS, help="the shell that reads the script")
    parser.add_argument(
        "--program", choices=PROGRAMS, default=PROGRAMS[0], help="the program to complete (default twindctl)"
    )


def run(options: argparse.Namespace) -> int:
    """Print the script. Returns the exit code."""
    from twind.manual.argument_parsers import programs  # imports every verb, which only this one needs
    from twind.manual.completion_script import completion_script

    program = next(each for each in programs() if each.name == options.program)
    print(completion_script(program.parser, options.shell), end="")
    return DONE
