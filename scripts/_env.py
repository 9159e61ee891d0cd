"""Continue in the checkout's own virtual environment where depthcli cannot be imported by this Python.

Every script in Python imports this module before anything that is not in the standard library. The environment is
the one that ``scripts/demo`` and ``scripts/test`` use; where there is none it is made first, which takes a minute.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
NEEDED = ("cv2", "depthcli", "numba", "pydantic", "typer", "yaml")


def main() -> None:
    """Return where everything needed can be imported; elsewhere, start the script again in ``.venv``."""
    if all(importlib.util.find_spec(name) for name in NEEDED):
        sys.path.insert(0, str(ROOT))  # this checkout's code, also where another one is installed
        return
    python = ROOT / ".venv" / "bin" / "python"
    if Path(sys.prefix) == python.parent.parent:
        sys.exit(f"{ROOT / '.venv'} is incomplete: delete it and start this script again")
    environment = {"PYTHON": sys.executable, **os.environ}
    if subprocess.run(["sh", str(ROOT / "scripts" / "_env.sh")], env=environment, check=False).returncode:
        sys.exit(1)
    os.execv(python, [str(python), *sys.argv])


def add_list(
    parser: argparse.ArgumentParser,
    flag: str,
    default: Sequence[Any],
    *,
    kind: Callable[[str], Any] = str,
    choices: Sequence[str] = (),
    help: str = "",
) -> None:
    """Add an option whose value is a list with commas, ``--only speed,accuracy``, each of ``kind`` and of ``choices``.

    It takes one word, so that a positional argument after it is not taken for another value, as by ``nargs="+"``.
    """

    def values(text: str) -> list[Any]:
        found = [kind(word.strip()) for word in text.split(",")]
        if wrong := [value for value in found if choices and value not in choices]:
            raise argparse.ArgumentTypeError(f"{wrong[0]!r} is none of {', '.join(choices)}")
        return found

    name = "N" if kind is int else "NAME"
    text = "; ".join(filter(None, [help, f"of {', '.join(choices)}" if choices else ""]))
    parser.add_argument(flag, type=values, default=default, metavar=f"{name},{name}", help=text or None)


main()
