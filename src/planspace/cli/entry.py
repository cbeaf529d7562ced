"""The entry point: find the verb, parse its options, run it, turn errors into one line and an exit code."""

import contextlib
import importlib
import inspect
import io
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import make_dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from planspace.cli.help_texts import set_help_texts
from planspace.cli.interrupts import Interrupted, interruptible
from planspace.errors import PlanspaceError, UsageError, printable

EXIT_FAILURE, EXIT_INTERRUPTED = 1, 130
PROGRAM = "planspace"
OUT_OF_MEMORY = ("std::bad_alloc", "RESOURCE_EXHAUSTED")
"""What errors of MuJoCo and of JAX say when memory is exhausted."""
DESCRIPTION = (
    "State embeddings in which demonstrated plans are straight lines. `planspace VERB --help` explains a "
    "verb. Every verb takes --debug, which shows the traceback of an error; --version prints the version."
)

VERBS = {
    "run": "Plan, embed, control in plan space and report in one command.",
    "plan": "Plan demonstrations from random starts to a goal.",
    "demos": "Show, check, draw, film, import and export demonstrations.",
    "embed": "Train an embedding on demonstrations.",
    "pixels": "Train an encoder that reads z from pictures.",
    "measure": "Measure the geometry of an embedding on demonstrations.",
    "export": "Export the encoder of an embedding for programs without Python.",
    "train": "Train policies on a task, all seeds at once.",
    "curves": "Draw the learning curves of several runs in one figure.",
    "control": "Steer a robot to its goal by looking ahead, with the distance in z as the cost.",
    "play": "Play a trained policy and film it.",
    "push": "Upload an embedding, plans or policies to the Hugging Face hub.",
    "study": "Run a study: many embeddings and policies, statistics and a report.",
    "report": "Write the report of a `planspace run` again.",
    "repair": "Find damaged files and set them aside.",
    "doctor": "Show what is installed, what is missing, and how to install it.",
}
"""Verb and summary. The verb `plan` is the dataclass `Plan` in `planspace.cli.plan`; its docstring begins
with the summary, its fields are its options, and calling it does the work. Only the verb in use is imported,
so that `--help` answers at once."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: what follows the program's name; by default the arguments of this process.

    Returns:
        The exit code: 0 done, 1 failed, 2 wrong usage, 3 partly done, 130 interrupted by Ctrl-C, 143 by
        SIGTERM.
    """
    with interruptible(whole_process=arguments is None):
        return _run(list(sys.argv[1:] if arguments is None else arguments))


def _run(arguments: list[str]) -> int:
    if "--version" in arguments:
        import planspace

        print(planspace.__version__)
        return 0
    debug = "--debug" in arguments
    try:
        parse([a for a in arguments if a != "--debug"])()
        sys.stdout.flush()  # here, where a closed pipe is expected
    except SystemExit as stop:
        return int(stop.code or 0)
    except BrokenPipeError:  # the reader of our output, such as `head`, has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt as interrupt:
        print("interrupted; the same command continues from here.", file=sys.stderr)
        return interrupt.exit_code if isinstance(interrupt, Interrupted) else EXIT_INTERRUPTED
    except Exception as error:
        if debug:
            _print_traceback()
        print(f"planspace: {_message(error)}", file=sys.stderr)
        return error.exit_code if isinstance(error, PlanspaceError) else EXIT_FAILURE
    return 0


def parse(arguments: Sequence[str]) -> Any:
    """Parse a command line into its verb, which is then called.

    Raises:
        SystemExit: with 0 after `--help`, with 2 after wrong options, which tyro explains in a box.
        UsageError: an option that decides the others, such as `--config`, is wrong, or an argument is empty.
    """
    if not arguments or arguments[0] not in VERBS:
        return _parse_with_tyro(_union_of_stubs(), arguments, PROGRAM, DESCRIPTION, None)
    verb, *rest = arguments
    _check_not_empty(rest)
    module = importlib.import_module(f"planspace.cli.{verb}")
    kind = getattr(module, verb.capitalize())
    default = kind.default(rest) if hasattr(kind, "default") else None
    return _parse_with_tyro(kind, rest, f"{PROGRAM} {verb}", inspect.getdoc(kind) or "", default)


def _check_not_empty(arguments: Sequence[str]) -> None:
    """Refuse an empty argument: as a path it would mean the working directory.

    Raises:
        UsageError: there is one.
    """
    for before, argument in zip(["", *arguments], arguments, strict=False):
        option, equals, value = argument.partition("=")
        if argument == "" or (option.startswith("--") and equals and not value):
            where = option or (before if before.startswith("--") else "an argument")
            raise UsageError(f"{where} is empty. Is a variable of the shell not set?")


def _parse_with_tyro(kind: Any, arguments: Sequence[str], prog: str, description: str, default: Any) -> Any:
    set_help_texts(kind, default)
    marked = tyro.conf.OmitSubcommandPrefixes[tyro.conf.OmitArgPrefixes[tyro.conf.FlagCreatePairsOff[kind]]]
    complaint = io.StringIO()
    given = {} if default is None else {"default": default}
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(marked, args=list(arguments), prog=prog, description=description, **given)
    except SystemExit as stop:
        if stop.code:
            box = "\n".join(printable(line) for line in complaint.getvalue().splitlines())
            print(box, file=sys.stderr)
        raise


def _union_of_stubs() -> Any:
    """A union of empty verbs, for `planspace --help` and for tyro's list of verbs after a wrong one."""
    stubs = [
        Annotated[make_dataclass(verb, [], namespace={"__doc__": summary}), tyro.conf.subcommand(verb)]
        for verb, summary in VERBS.items()
    ]
    return reduce(or_, stubs)


def _message(error: Exception) -> str:
    if isinstance(error, PlanspaceError):
        return str(error)
    if isinstance(error, MemoryError) or any(sign in str(error) for sign in OUT_OF_MEMORY):
        return "not enough memory for this command: try smaller numbers, for example of samples or seeds."
    if isinstance(error, RuntimeError) and "MUJOCO_GL" in str(error):
        from planspace.physics.rendering import rendering_advice  # here, so that `--help` answers at once

        return f"MuJoCo cannot be imported: {rendering_advice()}."
    return (
        f"unexpected {type(error).__name__}: {printable(' '.join(str(error).split()))} (--debug shows where)"
    )


def _print_traceback() -> None:
    lines = traceback.format_exc().splitlines()
    print("\n".join(map(printable, lines)), file=sys.stderr)
