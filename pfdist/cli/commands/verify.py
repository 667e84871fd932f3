"""The command ``pfdist verify``."""

from argparse import Namespace
from pathlib import Path

from pfdist.cli.arguments import add_run
from pfdist.cli.command import command
from pfdist.errors import StoreError, one_line


@command(
    "verify",
    add_run,
    examples={"pfdist verify results/plan": "Check a run after it was copied"},
)
def verify_command(options: Namespace) -> None:
    """Check every byte, row and key of a run."""
    from pfdist.store.repair import run_again, verify_run

    path = Path(options.run)
    damages = list(verify_run(path))
    for damage in damages:
        print(one_line(f"{path / damage.path} {damage.what}"))
    if not damages:
        print(f"{one_line(options.run)}: all files are unchanged, and no row or key is missing")
        return
    if all(damage.is_missing for damage in damages):
        raise StoreError(
            f"{path}: missing files: {len(damages)}. To recompute them, {run_again(path)}"
        )
    raise StoreError(
        f"{path}: problems found: {len(damages)}. Run `pfdist repair {path}` to move the damaged "
        "files to quarantine; it says how to recompute them"
    )
