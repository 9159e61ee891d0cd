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
extra=${extra-dev}
mark() { echo ".venv/ready${1:+-$1}"; }
is_ready() { [ -f "$(mark "$1")" ] && [ "$(cat "$(mark "$1")")" = "$wanted" ]; }
if ! is_ready "$extra"; then
  echo "setting up .venv ..." >&2
  is_ready "" || { rm -rf .venv && "$python" -m venv .venv; }
  # Modules are compiled to byte code as they are used: most of those in the packages never are.
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --editable ".${extra:+[$extra]}" >&2
  printf '%s' "$wanted" > "$(mark "")"
  printf '%s' "$wanted" > "$(mark "$extra")"
fi
PATH="$PWD/.venv/bin:$PATH"
export PATH
# Byte code is kept even where the environment asks for none: without it, a small command takes twice the time.
unset PYTHONDONTWRITEBYTECODE
