"""The `heliograph` command: its entry point and what becomes of errors."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import typer

from heliograph.cli import (
    align,
    calibrate,
    check,
    compare,
    demo,
    edit,
    evaluate,
    info,
    lab,
    localize,
    loops,
    merge,
    run,
    simulate,
    solve,
    support,
    survey,
    view,
)
from heliograph.cli.help import Front, Page
from heliograph.cli.interrupt import EndedError, ends_in_order
from heliograph.cli.options import PluggableCommand
from heliograph.cli.terminal import guarded_streams
from heliograph.errors import HeliographError, OutputError

__all__ = ["app", "main"]

DONE, DEFECT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

# typer carries click inside itself since 0.16, so its exceptions are reached through the one that typer exports.
ClickError: type[Exception] = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")

app = typer.Typer(
    name="heliograph",
    cls=Front,
    help="LiDAR-inertial mapping: recording in, trajectory and de-skewed map out.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
app.command("run", cls=PluggableCommand, short_help="Recording in, trajectory and map out: the main job.")(run.run)
app.command("info", cls=PluggableCommand, short_help="What a recording holds and what was inferred from it.")(info.info)
app.command("check", cls=Page, short_help="What is wrong with a recording's IMU, and what to do.")(check.check)
app.command(
    "localize", cls=PluggableCommand, short_help="A recording in a saved map: where it is, or that it is not known."
)(localize.localize)
app.command("loops", cls=Page, short_help="A run's loops: list, explain, revoke, add by hand.")(loops.loops)
app.command("edit", cls=Page, short_help="A plan of edits applied to a run: boxes, loops, sessions.")(edit.edit)
app.command("merge", cls=Page, short_help="Several runs in one map, from their folders.")(merge.merge)
app.command("survey", cls=Page, short_help="A run in a coordinate system, tied to control points.")(survey.survey)
app.command("compare", cls=Page, short_help="Runs side by side: distances, maps, loops, settings.")(compare.compare)
app.command("evaluate", cls=Page, short_help="A trajectory's errors against a reference.")(evaluate.evaluate)
app.command("calibrate", cls=Page, short_help="Mounting and clock of LiDAR and IMU, or IMU noise.")(calibrate.calibrate)
app.command("align", cls=Page, short_help="Two clouds: pose, overlap, and what was not observable.")(align.align)
app.command("solve", cls=Page, short_help="A pose graph in, its most likely poses out.")(solve.solve)
app.command("simulate", cls=Page, short_help="A recording with ground truth.")(simulate.simulate)
app.command("support", cls=Page, short_help="What a bug report needs of a run, no points or paths.")(support.support)
app.command("demo", cls=Page, short_help="Simulate, map, evaluate: see it work.")(demo.demo)
app.command("view", cls=Page, short_help="A run in Rerun: scans, map, loops, graph; or a file to share.")(view.view)
app.command("lab", cls=Page, short_help="The lesson's experiments in the browser.")(lab.lab)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"heliograph {installed('heliograph')}")
        raise typer.Exit


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the process's exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of ``sys.argv[1:]``.

    Returns
    -------
    int
        0 done (warnings included), 2 bad input or usage, 130 interrupted (129 and 143: by SIGHUP and SIGTERM), 1 a
        defect of Heliograph.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    with guarded_streams(), ends_in_order():
        return _outcome(arguments or ["--help"])


def _outcome(arguments: list[str]) -> int:
    if os.environ.get("HELIOGRAPH_ISA"):  # else there is nothing to check, and help loads no native code
        from heliograph import _core

        try:
            _core.instruction_set()
        except ValueError as error:  # it names a path that is not there
            return _fail(str(error))
    try:
        code = app(arguments, standalone_mode=False)
        sys.stdout.flush()
    except HeliographError as error:
        return _fail(str(error))
    except ClickError as error:
        return _fail(_usage(error))
    except EndedError as ended:
        return _fail(f"ended by {ended}", ended.code)
    except (KeyboardInterrupt, typer.Abort):
        return _fail("interrupted", INTERRUPTED)
    except (
        BrokenPipeError,
        SystemExit,
    ):  # of `heliograph info ... | head`; click exits then
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception:
        traceback.print_exc()
        return _fail("this is a defect of Heliograph, not of your data; please report it with the lines above", DEFECT)
    return code if isinstance(code, int) else DONE


def _fail(message: str, code: int = BAD_INPUT) -> int:
    with contextlib.suppress(OSError, OutputError):  # nobody hears it: the exit code still tells
        print("error:", " ".join(message.split()), file=sys.stderr)
    return code


def _usage(error: Exception) -> str:
    """Return a usage error as one line that says where help is."""
    message = getattr(error, "format_message", lambda: str(error))()
    context = getattr(error, "ctx", None)
    where = f"; see `{context.command_path} --help`" if context is not None else ""
    return f"{' '.join(message.split()).rstrip('.')}{where}"
