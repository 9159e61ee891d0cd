"""The command line: the only place with typer and exit codes.

Exit codes: 0 all done; 1 a bug; 2 wrong usage or config; 3 finished, but some scenes failed; 130 Ctrl-C.
Nothing heavy is imported here or by the command modules, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys

import typer

from depthcli.cli import evaluate, fuse, presets, sample, stereo
from depthcli.core.errors import DepthcliError

app = typer.Typer(
    name="depthcli",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("stereo", short_help="Image pairs to disparity maps.")(stereo.stereo)
app.command("fuse", short_help="The same, by several measures weighed pixel by pixel.")(fuse.fuse)
app.command("evaluate", short_help="Runs against ground truth, side by side.")(evaluate.evaluate)
app.command("sample", short_help="Generated scenes with exact ground truth.")(sample.sample)
app.command("presets", short_help="List the presets, or show one in full.")(presets.presets)


def _version(value: bool) -> None:
    if value:
        from depthcli import __version__

        print(f"depthcli {__version__}")
        raise typer.Exit


@app.callback()
def depthcli(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Depth from images: batch stereo matching and its evaluation, from YAML configs and image folders."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code; messages go to stderr, never a traceback except for a bug."""
    try:
        code = int(app(arguments, prog_name="depthcli", standalone_mode=False) or 0)
        sys.stdout.flush()
        if code == 130:  # typer turns Ctrl-C into this code, silently
            raise KeyboardInterrupt
        return code
    except DepthcliError as error:
        print(f"depthcli: {error}" if "\n" not in str(error) else str(error), file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        print("depthcli: interrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our stdout has gone, as in `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        show = getattr(error, "show", None)
        if show is not None and getattr(error, "exit_code", None) == 2:  # click's wrong usage, in its own words
            show()
            return 2
        import traceback

        traceback.print_exc()
        print("depthcli: this is a bug, not something you did; please report the lines above", file=sys.stderr)
        return 1
