# Makes the checkout's own virtual environment, or finds it ready. Sourced by the scripts in sh, run by _env.py for
# those in Python.
# Wants only a python3 of at least 3.11 with venv; PYTHON names another one.
set -eu
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
  echo "depthcli needs Python 3.11 or newer; $("$python" --version) is too old (set PYTHON)" >&2
  exit 1
}
wanted=$("$python" -c 'import hashlib, sys; print(sys.version, hashlib.sha256(open("pyproject.toml", "rb").read()).hexdigest())')
if [ ! -f .venv/ready ] || [ "$(cat .venv/ready)" != "$wanted" ]; then
  echo "setting up .venv ..." >&2
  rm -rf .venv
  "$python" -m venv .venv
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]' >&2
  printf '%s' "$wanted" > .venv/ready
fi
PATH="$PWD/.venv/bin:$PATH"
export PATH
