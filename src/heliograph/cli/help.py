"""Help that fits a terminal of 24 lines: what it does, an example, the options one uses; `--help-all` has the rest."""

from __future__ import annotations

import re
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from heliograph.cli.activity import announced

__all__ = ["Front", "Page"]

LINES = 24
"""Lines of the smallest terminal that help fits."""
_RANGE = re.compile(r"x>=(\d+)(?:\.0)?(?=\])")

EXAMPLES: dict[str, tuple[str, ...]] = {
    "run": ("run drive.mcap", "run drive.mcap --crs utm --rrd drive.rrd"),
    "info": ("info drive.mcap",),
    "check": ("check drive.mcap --imu", "check drive_heliograph"),
    "localize": ("localize today.mcap --map drive_heliograph",),
    "loops": ("loops drive_heliograph", "loops drive_heliograph --revoke 3"),
    "edit": ("edit drive_heliograph plan.toml",),
    "merge": ("merge monday_heliograph tuesday_heliograph -o both",),
    "survey": ("survey drive_heliograph --crs EPSG:25832",),
    "compare": ("compare a_heliograph b_heliograph", "compare a_heliograph b_heliograph --html compare.html"),
    "evaluate": ("evaluate drive_heliograph truth.tum",),
    "calibrate": ("calibrate drive.mcap",),
    "align": ("align monday.ply tuesday.ply",),
    "solve": ("solve sphere.g2o -o solved.g2o",),
    "simulate": ("simulate warehouse --duration 20",),
    "support": ("support drive_heliograph",),
    "demo": ("demo",),
    "view": ("view drive_heliograph", "view drive_heliograph --rrd drive.rrd"),
    "lab": ("lab", "lab tunnel"),
}
"""Command -> examples, without the program's name."""
MAIN: dict[str, tuple[str, ...]] = {
    "run": ("output", "overwrite", "resume", "odometry", "extrinsic", "duration", "wheels", "crs", "view", "settings"),
    "info": ("lidar_topic", "imu_topic", "extrinsic", "start", "duration", "json"),
    "localize": ("map", "output", "overwrite", "start", "duration", "extrinsic", "config", "settings", "json", "quiet"),
    "calibrate": ("noise", "output", "overwrite", "extrinsic", "start", "duration", "settings", "json"),
    "solve": ("output", "solver", "init", "robust", "max_iterations", "threads", "plot", "overwrite", "json"),
    "align": ("init", "method", "output", "overwrite", "json"),
    "check": ("imu", "duration", "extrinsic", "json", "quiet"),
}
"""Command -> names of the options that its short help shows, where all of them do not fit."""


class Page(TyperCommand):
    """A command whose `--help` fits the screen, with an example, and whose `--help-all` says everything."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401 - typer's click has no public types
        """Answer `--help-all`, and leave all else to the parser."""
        before = args[: args.index("--")] if "--" in args else args
        if "--help-all" in before:
            typer.echo(self.whole_help(ctx))
            ctx.exit()
        parsed: list[str] = super().parse_args(ctx, args)
        return parsed

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401
        """Do what the command does, and tell what it is at once that takes its time."""
        with announced(self.name or "", quiet=bool(ctx.params.get("quiet"))):
            return super().invoke(ctx)

    def whole_help(self, ctx: Any) -> str:  # noqa: ANN401
        """Return the help with every option."""
        return str(super().get_help(ctx))

    def get_help(self, ctx: Any) -> str:  # noqa: ANN401
        """Return all of the help where that fits, else its main part."""
        whole = self.whole_help(ctx)
        return whole if whole.count("\n") < LINES else self._short(ctx)

    def _short(self, ctx: Any) -> str:  # noqa: ANN401
        formatter = ctx.make_formatter()
        width = formatter.width
        self.format_usage(ctx, formatter)
        formatter.write("\n")
        first = (self.help or "").split("\n\n")[0].replace("\b", "")
        with formatter.indentation():
            formatter.write_text(" ".join(first.split()))
        self._write_examples(formatter)
        chosen, rows = MAIN.get(self.name or "", ()), []
        for parameter in self.get_params(ctx):
            record = _record(parameter, ctx)
            if record is not None and (parameter.name in chosen or not chosen):
                rows.append(record)
        room = LINES - 2 - formatter.getvalue().count("\n") - len("\nOptions:\n".splitlines())
        wrapped = ctx.make_formatter()
        with wrapped.indentation():
            wrapped.write_dl(rows)
        text = str(wrapped.getvalue())
        if text.count("\n") > room:
            wide = min(max((len(name) for name, _ in rows), default=0), 30)
            text = "".join(f"{_cut(f'  {name.ljust(wide)}  {said}', width)}\n" for name, said in rows[:room])
        formatter.write(f"\nOptions:\n{text}")
        count = sum(_record(parameter, ctx) is not None for parameter in self.get_params(ctx))
        formatter.write(f"\n  {ctx.command_path} --help-all has all {count} of them.\n")
        return str(formatter.getvalue().rstrip("\n"))

    def format_help_text(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write what the command does, and examples."""
        super().format_help_text(ctx, formatter)
        self._write_examples(formatter)

    def _write_examples(self, formatter: Any) -> None:  # noqa: ANN401
        examples = EXAMPLES.get(self.name or "", ())
        if examples:
            formatter.write("\n" + "".join(f"  heliograph {example}\n" for example in examples))

    def format_options(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write arguments and options in words: no types of the language, no inequalities."""
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            rows = [
                record
                for parameter in self.get_params(ctx)
                if parameter.param_type_name == kind and (record := _record(parameter, ctx)) is not None
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


class Front(TyperGroup):
    """The program's own help: every command in a line."""

    def get_help(self, ctx: Any) -> str:  # noqa: ANN401
        """Return what it is, its commands, and where to begin."""
        width = ctx.make_formatter().width
        names = self.list_commands(ctx)
        wide = max(map(len, names))
        shown = [(name, command.get_short_help_str(200)) for name in names if (command := self.get_command(ctx, name))]
        lines = [" ".join((self.help or "").split()), ""]
        lines += [f"  {name.ljust(wide)}  {text}" for name, text in shown]
        lines += ["", f"`{ctx.command_path} demo` shows it at work, `{ctx.command_path} COMMAND --help` says more.",
                  "--version; --install-completion teaches the shell the commands."]  # fmt: skip
        return "\n".join(_cut(line, width) for line in lines)


def _record(parameter: Any, ctx: Any) -> tuple[str, str] | None:  # noqa: ANN401
    """Return how a parameter is written and what it does; None for one that help does not name."""
    found = parameter.get_help_record(ctx)
    if found is None:
        return None
    name, text = found
    if parameter.param_type_name == "argument":
        name = re.sub(r"\s*<.*>$", "", name)
    return name, " ".join(_RANGE.sub(r"\1 or more", text).split())


def _cut(line: str, width: int) -> str:
    return line if len(line) <= width else f"{line[: width - 3].rstrip()}..."
