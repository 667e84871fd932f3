#!/usr/bin/env bash
# Runs a job on this machine from any folder, so from nohup, cron and at too:
#     nohup jobs/local.sh jobs/paper.toml --workers 8 > paper.log 2>&1 &
# PFDIST_VENV names the virtual environment that holds pfdist, for where PATH is bare (cron).
set -euo pipefail

if [[ ! -f ${1:-} ]]; then
    echo "usage: $0 JOB [pfdist run options...]" >&2
    echo "JOB must be a job file, got '${1:-}'" >&2
    exit 2
fi
PATH=${PFDIST_VENV:+$PFDIST_VENV/bin:}$PATH

# The same results folder from wherever it is called: otherwise the same command would not go on.
results=$(realpath "$(dirname "$0")/..")/results/$(basename "$1" .toml)

# exec: signals reach pfdist itself, which stops cleanly and says so by its exit code.
exec pfdist run "$1" --results "$results" "${@:2}"
