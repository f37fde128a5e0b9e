"""How commands are called: their help, and the message for a wrong call, from the catalogues like all else.

An option names the code of its help (``help="help-speed"``), a command's is ``help-command-`` and its name. What
the command line library would say in English is put into words here.
"""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Callable, Iterable, Iterator
from inspect import Signature, signature
from typing import Any, TypeVar, get_type_hints

from typer.core import TyperCommand, TyperGroup

from api.outputs import in_words
from daq.records import InputError
from daq.tables import nearest, why_of
from daq.words import Message, say

WIDEST = 110
"""Columns of a help page, as wide as a paragraph reads well."""
PLACEHOLDER = re.compile(r"\b(?!(?:CSV|EUR|JSON|URL)\b)[A-Z]{2,}\b")
"""A word in capitals that stands for something, what is written so everywhere aside."""


Options = TypeVar("Options")


def taking(options: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Make the fields of a dataclass the arguments and options of a command, which takes them as one value."""
    hints = get_type_hints(options, include_extras=True)
    fields = [p.replace(annotation=hints[name]) for name, p in signature(options).parameters.items()]

    def taken(command: Callable[[Options], None]) -> Callable[..., None]:
        def called(**given: Any) -> None:
            command(options(**given))

        vars(called)["__signature__"] = Signature(fields)
        called.__doc__ = command.__doc__
        return called

    return taken


class Command(TyperCommand):
    """A command whose help comes from the catalogues."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the call. Raises `InputError` for words that nothing takes."""
        ctx.allow_extra_args = True
        rest = super().parse_args(ctx, args)
        if ctx.args and not ctx.resilient_parsing:  # a shell that completes asks about half a call
            raise InputError(say("call-surplus", words=tuple(ctx.args)))
        return rest

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Return what the word may become, for the shell."""
        return _with_words(super().shell_complete(ctx, incomplete), self.get_params(ctx))

    def get_help(self, ctx: Any) -> str:
        """Return the help page."""
        return "\n".join(help_lines(self, ctx))


class Group(TyperGroup):
    """All commands, with their help from the catalogues."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that is called. Raises `InputError` for one that does not exist."""
        if args[0] not in self.commands and not ctx.resilient_parsing:
            meant = nearest(args[0], self.commands)
            problem = say("call-command-unknown", command=args[0])
            raise InputError(
                problem if meant is None else say("call-command-unknown-meant", meant=meant, command=args[0])
            )
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Return what the word may become, for the shell."""
        found = super().shell_complete(ctx, incomplete)
        for item in found:
            if item.value in self.commands:
                item.help = command_help(item.value).code
        return _with_words(found, self.get_params(ctx))

    def get_help(self, ctx: Any) -> str:
        """Return the help page."""
        commands = [(name, command_help(name)) for name in self.commands]
        return "\n".join([*help_lines(self, ctx), *_section(say("help-commands"), commands)])


def _with_words(items: list[Any], parameters: Iterable[Any]) -> list[Any]:
    """Give completions their help from the catalogues, where they have one, each in a line."""
    from rich.markup import escape  # the shell's scripts have markup taken out

    known = {name: parameter_help(one) for one in parameters for name in one.opts}
    for item in items:
        if text := known.get(item.value, Message(item.help) if item.help else None):
            item.help = escape(textwrap.shorten(in_words(text), _width() - 1, placeholder="…"))
    return items


def command_help(name: str) -> Message:
    """Return what a command does."""
    return Message(f"help-command-{name}")


def parameter_help(parameter: Any) -> Message:
    """Return what an argument or option is, with the limits it has and what stands in for it."""
    code = "help-help" if parameter.name == "help" else str(parameter.help)
    limits = {"least": vars(parameter).get("min"), "most": vars(parameter).get("max")}
    return Message(code, {name: value for name, value in limits.items() if value is not None} | _usual(code))


def _usual(code: str) -> dict[str, Any]:
    """Return what is taken where an option is not given and no default shows it, read where it stands."""
    if code in ("help-baud", "help-tcp-port", "help-timeout"):
        from daq.drivers.probe import BAUD, TIMEOUT_S
        from daq.drivers.profile import TCP_PORT

        return {"baud": BAUD, "port": TCP_PORT, "seconds": TIMEOUT_S}
    if code == "help-panel":
        from daq.press.header import USUAL_PANEL

        return {"material": USUAL_PANEL["panel.material"], "millimetres": USUAL_PANEL["panel.thickness_mm"]}
    if code == "help-probability":
        from daq.press.resin_file import PROBABILITY

        return {"probability": PROBABILITY}
    if code in ("help-rehearse-campaigns", "help-reproduce-paper"):
        from softsensor.fitting.paper.virtual_runs import MEASUREMENTS
        from softsensor.jobs.rehearsals import CAMPAIGNS

        return {"campaigns": CAMPAIGNS, "measurements": MEASUREMENTS}
    return _usual_ranges() if code == "help-advice-range" else {}


def _usual_ranges() -> dict[str, Any]:
    from softsensor.planning.advise import DEFAULT_RANGES

    names = {"platen": "platen_temperature_C", "time": "press_time_s", "pressure": "pressure_N_cm2"}
    ranges = {short: DEFAULT_RANGES[name] for short, name in names.items()}
    return {
        f"{short}_{end}": number
        for short, pair in ranges.items()
        for end, number in zip(("from", "to"), pair, strict=True)
    }


def placeholders(call: str) -> str:
    """Return what stands for a value in a call, ``KEY=VALUE`` say, in the terminal's language."""
    return PLACEHOLDER.sub(lambda word: in_words(Message(f"help-word-{word[0].lower()}")), call)


def help_lines(command: TyperCommand | TyperGroup, ctx: Any) -> Iterator[str]:
    """Yield the help page of a command: how it is called, what it does, what it takes."""
    call = " ".join([ctx.command_path, *map(placeholders, command.collect_usage_pieces(ctx))])
    yield in_words(say("help-usage", call=call))
    yield ""
    yield from textwrap.wrap(
        in_words(command_help(command.name or "")), _width(), initial_indent="  ", subsequent_indent="  "
    )
    options: list[tuple[str, Message]] = []
    arguments: list[tuple[str, Message]] = []
    for one in command.get_params(ctx):
        parameter: Any = one
        text = parameter_help(parameter)
        if parameter.param_type_name == "argument":
            arguments.append((" ".join(map(placeholders, parameter.get_usage_pieces(ctx))), text))
            continue
        if parameter.default not in (None, False, "") and not parameter.required:
            text = say("help-default", text=text, value=parameter.default)
        if parameter.envvar:
            text = say("help-environment", text=text, name=parameter.envvar)
        options.append((" ".join(filter(None, (parameter.opts[-1], placeholders(parameter.metavar or "")))), text))
    yield from _section(say("help-arguments"), arguments)
    yield from _section(say("help-options"), options)


def _section(heading: Message, rows: list[tuple[str, Message]]) -> Iterable[str]:
    if not rows:
        return
    yield ""
    yield in_words(heading)
    wide = max(len(name) for name, _ in rows) + 4
    for name, text in rows:
        first, *more = textwrap.wrap(in_words(text), max(_width() - wide, 30))
        yield f"  {name:{wide - 2}}{first}"
        yield from (" " * wide + line for line in more)


def _width() -> int:
    return min(shutil.get_terminal_size().columns, WIDEST)


def refusal_of(error: Exception) -> Message:
    """Return the message for a call that the command line library refuses; its errors differ."""
    refused: Any = error
    option = getattr(error, "option_name", None)
    if option is not None and not hasattr(error, "possibilities"):
        return say("call-option-without-value", option=option)
    if option is not None and refused.possibilities:
        return say("call-option-unknown-meant", option=option, meant=tuple(sorted(refused.possibilities)))
    if option is not None:
        return say("call-option-unknown", option=option)
    parameter = getattr(error, "param", None)
    if parameter is None:
        return say("plain-text", text=str(refused.message))
    name = parameter.opts[-1] if parameter.param_type_name == "option" else placeholders(parameter.metavar)
    if not refused.message:
        return say("at-key", key=name, what=say("key-missing"))
    from pydantic import ValidationError

    if not isinstance(error.__cause__, ValidationError):
        return say("at-key", key=name, what=say("plain-text", text=str(refused.message)))
    item = error.__cause__.errors()[0]
    choices = tuple(str(parameter.metavar).split("|"))
    why = say("call-not-one-of", known=choices) if len(choices) > 1 else why_of(item)
    return say("at-key-value", key=name, value=repr(item["input"]), what=why)
