# Functions of .ci/run and .ci/all.

# shellcheck shell=bash disable=SC1090,SC1091,SC2154 # each script makes the folder "$scratch"
export PIP_DISABLE_PIP_VERSION_CHECK=1

step() { echo "== $(date +%T) $*"; }

# A new virtual environment with nothing in it, which is active then: environment NAME [PYTHON]
environment() {
    if declare -F deactivate > /dev/null; then deactivate; fi # of an environment of this script
    "${2:-python3}" -m venv "$scratch/$1"
    activate "$1"
}

# The cache belongs to the environment, so nothing is compiled in a new one, as on a new machine.
activate() {
    source "$scratch/$1/bin/activate"
    export MPLCONFIGDIR="$scratch/$1/matplotlib" PFDIST_CACHE_DIR="$scratch/$1/kernels"
}

# The locked versions of everything, and the checkout.
locked_environment() {
    environment locked
    pip install -q --require-hashes -r requirements/locked.txt
    pip install -q --no-deps --no-build-isolation -e .
    touch "$scratch/locked.done"
}

# The path of a Python, by its version; empty if this machine lacks it.
python_of() {
    local each
    for each in "$(command -v "python$1" || true)" "$HOME"/.pyenv/versions/"$1".*/bin/python; do
        if [ -x "$each" ] && "$each" -c "import ensurepip" 2> /dev/null; then
            echo "$each"
            return
        fi
    done
}

# The newest Python above the oldest that this machine has; the versions are those of ray and numba.
newest_python() {
    local version
    for version in 3.14 3.13 3.12; do
        if [ -n "$(python_of $version)" ]; then
            echo "$version"
            return
        fi
    done
}

# The first or the second of the two commands of README.md, word for word: run_readme 1
run_readme() {
    local command
    command=$(awk '/^## Two commands/ {found = 1}
        found && /^```/ {if (inside) exit; inside = 1; next} inside' README.md | sed -n "$1p")
    [[ $command == pip\ install* ]] # else README.md has changed
    bash -c "$command"
}

# Whether a program is there, or packages of Debian bring it: has PROGRAM PACKAGE...
has() {
    if command -v "$1" > /dev/null; then return; fi
    export DEBIAN_FRONTEND=noninteractive
    if ! apt-get update -q > /dev/null ||
        ! apt-get install -y -q --no-install-recommends "${@:2}" > /dev/null; then
        echo "$1 is not on this machine, and $2 cannot be installed"
        return 1
    fi
}

# What the first command printed must be what README.md shows: as_readme_shows FILE
as_readme_shows() {
    python - "$1" <<'PY'
import re
import sys
from pathlib import Path

readme = Path("README.md").read_text(encoding="utf-8")
printed = Path(sys.argv[1]).read_text(encoding="utf-8").splitlines()
block = re.search(r"^```\n(Measure at .*?)^```", readme, re.MULTILINE | re.DOTALL)
assert block is not None, "README.md shows no answer"
missing = [line for line in block[1].splitlines() if line not in [*printed, "..."]]
assert not missing, f"README.md shows {missing}, but its command printed {printed}"
print("the first command prints what README.md shows")
PY
}
