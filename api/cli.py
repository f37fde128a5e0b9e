"""The command `kerntemp`: every way in and out for a person at a terminal.

Commands import what they need when they run, so that `kerntemp --help` answers at once.
Exit status: 0 done, 1 the work failed, 2 the input or the call is wrong; then one line on
standard error says what is wrong and what to do, and nothing has been written.
KERNTEMP_LANGUAGE chooses the language of messages; it is read here, once.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from api.commands import files, services
from api.commands import simulating as analysis
from api.commands.advising import advise
from api.commands.blistering import blisters
from api.commands.calibrating import calibrate
from api.commands.calling import Command, Group, refusal_of
from api.commands.demo import demo
from api.commands.diagnosing import diagnose
from api.commands.fitting import fit
from api.commands.guiding import guide
from api.commands.keeping import backup
from api.commands.planning import plan
from api.commands.probing import probe
from api.commands.publishing import publish
from api.outputs import WorkFailed, in_words, speak, warnings_as_lines
from daq.records import InputError
from daq.words import Message, say, spoken
from daq.words.message import ENGLISH, languages

app = typer.Typer(
    name="kerntemp",
    cls=Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback(invoke_without_command=True)
def about(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="help-version")] = False,
    licences: Annotated[bool, typer.Option("--licences", help="help-licences")] = False,
    completion: Annotated[str, typer.Option("--completion", metavar="SHELL", help="help-completion")] = "",
) -> None:
    """Core temperature of pressed panels: log, predict live, fit, and find what the model gets wrong."""
    if version:
        from api.answers.health import installed_version

        sys.stdout.write(f"kerntemp {installed_version()}\n")
    if licences:
        from api.commands.licences import licence_lines

        sys.stdout.write("\n".join(licence_lines()) + "\n")
    if completion:
        sys.stdout.write(_completion_script(completion))
    if version or licences or completion:
        raise typer.Exit
    if context.invoked_subcommand is None:
        raise InputError(say("call-command-missing"))


app.command("demo", cls=Command)(demo)
app.command("record", cls=Command)(services.record)
app.command("sense", cls=Command)(services.sense)
app.command("serve", cls=Command)(services.serve)
app.command("publish", cls=Command)(publish)
app.command("refit", cls=Command)(services.refit)
app.command("fit", cls=Command)(fit)
app.command("diagnose", cls=Command)(diagnose)
app.command("plan", cls=Command)(plan)
app.command("advise", cls=Command)(advise)
app.command("blisters", cls=Command)(blisters)
app.command("simulate", cls=Command)(analysis.simulate)
app.command("predict", cls=Command)(analysis.predict)
app.command("import", cls=Command)(files.import_runs)
app.command("export", cls=Command)(files.export_runs)
app.command("check", cls=Command)(files.check)
app.command("backup", cls=Command)(backup)
app.command("probe", cls=Command)(probe)
app.command("calibrate", cls=Command)(calibrate)
app.command("token", cls=Command)(services.token)
app.command("guide", cls=Command)(guide)


ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""How many threads NumPy's and SciPy's linear algebra takes for a product; read when they are first imported."""
COMPLETE = "_KERNTEMP_COMPLETE"
"""Variable in which a shell that completes asks; the command line library reads it."""
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""The command line library's 'wrong call'; typer names only its subclass in public."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    Matrices are small here and runs are already solved beside each other: threads within a product wait for one
    another, and cost a diagnosis of twelve runs a sixth of its processor time (158 s, 131 s with one; 2026-11-27).
    """
    os.environ.setdefault(ONE_THREAD, "1")
    if COMPLETE in os.environ:
        from typer._completion_classes import completion_init

        completion_init()
    try:
        _choose_language(os.environ.get("KERNTEMP_LANGUAGE", ENGLISH))
        with warnings_as_lines():
            status = app(args=arguments, prog_name="kerntemp", standalone_mode=False)
    except (InputError, _UsageError, WorkFailed) as error:
        return _complain(error, 1 if isinstance(error, WorkFailed) else 2)
    except (KeyboardInterrupt, typer.Abort):
        return _complain(KeyboardInterrupt(say("terminal-interrupted")), 130)
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123 - the reader of our output has gone
        return 0
    except Exception as error:
        if "KERNTEMP_TRACEBACK" in os.environ:
            raise
        if not isinstance(error.args[0] if error.args else None, Message):  # nobody foresaw it
            error = WorkFailed(say("terminal-unexpected", kind=type(error).__name__, why=str(error)))
        return _complain(error, 1)
    return status if isinstance(status, int) else 0


def _completion_script(shell: str) -> str:
    """Return what a shell has to read to complete with Tab. Raises `InputError`."""
    if shell not in ("bash", "zsh", "fish"):
        raise InputError(say("terminal-completion-shell", shell=shell))
    from typer._completion_shared import get_completion_script

    return get_completion_script(prog_name="kerntemp", complete_var=COMPLETE, shell=shell) + "\n"


def _choose_language(language: str) -> None:
    known = language in languages()
    speak(language if known else ENGLISH)
    if not known:
        raise InputError(say("terminal-language-unknown", language=language, languages=languages()))


def _complain(error: BaseException, status: int) -> int:
    text = in_words(refusal_of(error) if isinstance(error, _UsageError) else spoken(error))
    sys.stderr.write("kerntemp: " + " ".join(text.split()) + "\n")
    return status
