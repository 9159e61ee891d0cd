# Makes the checkout's own virtual environment, or finds it ready. Sourced by the scripts in sh, run by _env.py for
# those in Python.
# Wants only a python3 of at least 3.11 with venv; PYTHON names another one. With extra="" it installs what the
# program needs, else also what its tests need.
set -eu
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
  echo "depthcli needs Python 3.11 or newer; $("$python" --version) is too old (set PYTHON)" >&2
  exit 1
}
wanted=$("$python" -c 'import hashlib, sys; print(sys.version, hashlib.sha256(open("pyproject.toml", "rb").read()).hexdigest())')
is_ready() { [ -f ".venv/ready$1" ] && [ "$(cat ".venv/ready$1")" = "$wanted" ]; }
if ! is_ready "" || ! is_ready "${extra-dev}"; then
  echo "setting up .venv ..." >&2
  is_ready "" || rm -rf .venv
  is_ready "" || "$python" -m venv .venv
  # Modules are compiled to byte code as they are used: most of those in the packages never are.
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --editable ".[${extra-dev}]" >&2
  printf '%s' "$wanted" > .venv/ready
  printf '%s' "$wanted" > ".venv/ready${extra-dev}"
fi
PATH="$PWD/.venv/bin:$PATH"
export PATH
