"""Continue in the checkout's own virtual environment where depthcli cannot be imported by this Python.

Every script in Python imports this module before anything that is not in the standard library. The environment is
the one that ``scripts/demo`` and ``scripts/test`` use; where there is none it is made first, which takes a minute.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

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


main()
