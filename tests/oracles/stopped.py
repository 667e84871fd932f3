"""The lines that a command says when it is asked to end."""

import signal

_STOPPING = "pfdist: Stopping after the work in flight; {} again to end now"
STOPPING = {signal.SIGINT: _STOPPING.format("press Ctrl-C")} | {
    number: _STOPPING.format(f"send {number.name}")
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
}
"""The answer to the first signal, which says how to end at once."""
STOPPED = "pfdist: Stopped."
SAVED = f"{STOPPED} Finished work is saved; run the same command to resume."
