"""Continue in the checkout's own virtual environment where depthcli cannot be imported by this Python.

Every script in Python imports this module before anything that is not in the standard library. The environment is
the one that ``scripts/demo`` and ``scripts/test`` use; where there is none it is made first, which takes a minute.
"""

import argparse
import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
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


def options(about: str | None, *paths: str, **defaults: Any) -> argparse.Namespace:
    """Return the options on the command line of a script, whose docstring is its help.

    ``paths`` are given in order; ``[data]``, the folder of data sets, has a default. Each other option, ``--name``, has
    the type of its default: False, a flag; None, a path; a list, words or numbers with commas, ``--windows 3,11``,
    of a tuple only those that it holds. A list takes one word, so that a path after it is none of its values.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in paths:
        optional = {"nargs": "?", "default": ROOT.parent / "shared" / "data"} if name[0] == "[" else {}
        parser.add_argument(name.strip("[]"), type=Path, **optional)
    for name, default in defaults.items():
        how: dict[str, Any] = {"type": Path if isinstance(default, Path) else type(default)}
        if default is False:
            how = {"action": "store_true"}
        elif default is None:
            how = {"type": Path}
        elif isinstance(default, list | tuple):
            how = {"type": partial(_words, default), "metavar": "A,B", "help": f"default: {str(default)[1:-1]}"}
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, **how)
    return parser.parse_args()


def depthcli(*words: object) -> list[str]:
    """Return the command line of a quiet depthcli in a process of its own."""
    return [sys.executable, "-m", "depthcli", *map(str, words), "--quiet"]


def _words(known: Sequence[Any], text: str) -> list[Any]:
    found = [type(known[0])(word.strip()) for word in text.split(",")]
    if isinstance(known, tuple) and (wrong := set(found) - set(known)):
        raise argparse.ArgumentTypeError(f"{wrong.pop()!r} is none of {', '.join(known)}")
    return found


main()
