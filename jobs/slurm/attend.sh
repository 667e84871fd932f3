# shellcheck shell=bash
# Read by the batch scripts beside this file. It runs pfdist, hands the signals of Slurm on to it, and
# requeues the job when pfdist ends with exit code 75: "the same command goes on from here".
# PFDIST_VENV names the virtual environment that holds pfdist, if PATH does not.
PATH=${PFDIST_VENV:+$PFDIST_VENV/bin:}$PATH
_IDLE_REQUEUES=3 # so many requeues in a row may commit nothing

# attend COMMAND JOB OPTIONS...: run `pfdist COMMAND JOB OPTIONS...`, and end the script as it ends.
attend() {
    local child status=0 ended_by_slurm=
    stop_if_idle "$@"
    # In the background, because bash runs no trap while it waits for a command.
    pfdist "$@" &
    child=$!
    # "|| true": it may just have ended.
    trap 'kill -USR1 "$child" 2> /dev/null || true' USR1
    trap 'kill -TERM "$child" 2> /dev/null || true; ended_by_slurm=yes' TERM
    # Not `wait` alone: a signal ends it early, and if the child ends just then bash loses its status.
    while kill -0 "$child" 2> /dev/null; do
        sleep 1 || true # Slurm's TERM ends it, too
    done
    trap '' USR1 TERM
    wait "$child" || status=$?
    # Not after TERM: `scancel` sends it, and the job would come back; a job that is preempted has been
    # requeued by Slurm.
    if [[ $status == 75 && ! $ended_by_slurm ]]; then
        scontrol requeue "$SLURM_JOB_ID"
    elif [[ $status != 75 ]]; then
        rm -f ".pfdist-slurm-$SLURM_JOB_ID"
    fi
    exit "$status"
}

# Count the requeued starts in a row that have committed nothing, however they ended; after three,
# the next start says so and ends. A hidden file in the folder of submission keeps the count, and its
# age says when the last start began.
stop_if_idle() {
    local mark=.pfdist-slurm-$SLURM_JOB_ID idle=0 results committed i
    results=results/$(basename "$2" .toml) # and -plan or -sweep after it
    [[ ! -f $(dirname "$2")/run.json ]] || results=$(dirname "$2")
    for ((i = 3; i <= $#; i++)); do
        case ${!i} in
            --results) ((++i)) && results=${!i:-} ;;
            --results=*) results=${!i#*=} ;;
        esac
    done
    if [[ -f $mark && ${SLURM_RESTART_COUNT:-0} -gt 1 ]]; then # else the last start was no requeue
        # A committed table file is a *.parquet. The timings of failed tasks are no progress.
        committed=$(find "$results"* -name '*.parquet' ! -path '*/timings/*' -newer "$mark" \
            -print -quit 2> /dev/null || true)
        [[ $committed ]] || idle=$(($(< "$mark") + 1))
    fi
    if ((idle >= _IDLE_REQUEUES)); then
        rm "$mark"
        echo "stopped: $idle requeues in a row have committed nothing to $results." \
            "Submit again with a longer --time." >&2
        exit 1
    fi
    echo "$idle" > "$mark"
}
