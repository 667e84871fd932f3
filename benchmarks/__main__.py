"""``python -m benchmarks``: run benchmarks, and write tables, figures and README."""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from benchmarks import (
    accelerator,
    backtest,
    constants,
    coverage,
    densities,
    designs,
    driver,
    estimators,
    genetic,
    growth,
    guided,
    kernel,
    online,
    peers,
    prefixes,
    robust,
    rules,
    scaling,
    search,
    simulators,
    size,
    stone_soup,
    sweep,
    wall,
    ways,
)
from benchmarks.machine import provenance
from benchmarks.peers import PeerDisagreesError
from benchmarks.results import Benchmark, redraw, save, write_readme

# JAX comes last: it leaves threads behind, and other benchmarks start processes.
BENCHMARKS: dict[str, Benchmark] = {
    "kernel": kernel,
    "densities": densities,
    "prefixes": prefixes,
    "growth": growth,
    "guided": guided,
    "constants": constants,
    "designs": designs,
    "estimators": estimators,
    "coverage": coverage,
    "backtest": backtest,
    "scaling": scaling,
    "driver": driver,
    "ways": ways,
    "search": search,
    "genetic": genetic,
    "online": online,
    "stone_soup": stone_soup,
    "robust": robust,
    "rules": rules,
    "sweep": sweep,
    "wall": wall,
    "size": size,
    "simulators": simulators,
    "peers": peers,
    "accelerator": accelerator,
}
FOLDER = Path(__file__).parent / "results"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command line. By default those of the process.

    Returns
    -------
    int
        The exit code: 1 if a peer computes another result than pfdist.
    """
    options = _parser().parse_args(arguments)
    mpl.use("Agg")
    folder = options.results
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="benchmarks-")) if options.quick else FOLDER
    names = [name for name in BENCHMARKS if name in options.names or not options.names]
    if options.redraw:
        for name in names:
            redraw(folder, name, BENCHMARKS[name])
        return 0
    for name in names:
        start = time.perf_counter()

        def say(line: str, name: str = name, start: float = start) -> None:
            print(f"{name} {time.perf_counter() - start:5.0f} s  {line}", flush=True)  # noqa: T201

        try:
            tables = BENCHMARKS[name].measure(options.quick, say)
        except PeerDisagreesError as error:
            sys.stderr.write(f"benchmarks: {error}\n")
            return 1
        save(folder, name, BENCHMARKS[name], tables, provenance())
        say("done")
    text = write_readme(folder, BENCHMARKS)
    print(f"\n{text}\n{folder}")  # noqa: T201
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks", description="Measure what pfdist costs.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", type=_name, help=f"{', '.join(BENCHMARKS)} (all)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="small problems, into a temporary folder: a test"
    )
    parser.add_argument(
        "--redraw", action="store_true", help="draw figures from the tables, and measure nothing"
    )
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="output folder (benchmarks/results)"
    )
    return parser


def _name(text: str) -> str:
    if text not in BENCHMARKS:
        raise argparse.ArgumentTypeError(f"must be one of {', '.join(BENCHMARKS)}, got {text!r}")
    return text


if __name__ == "__main__":
    sys.exit(main())
