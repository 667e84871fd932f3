"""The lines of a run's manifest, read and changed by hand."""

from pathlib import Path


def said_of(run: Path, start: object) -> list[str]:
    """Lines of the files whose paths begin so; of the run itself for ``run``."""
    lines = (run / "manifest").read_text().splitlines()
    return [line for line in lines if _is_of(line, str(start))]


def change(run: Path, start: object, lines: list[str]) -> None:
    """Put other lines in the place of those that `said_of` gives."""
    manifest = run / "manifest"
    before = [line for line in manifest.read_text().splitlines() if not _is_of(line, str(start))]
    manifest.write_text("".join(f"{line}\n" for line in [*before, *lines]))


def _is_of(line: str, start: str) -> bool:
    word, _, rest = line.partition(" ")
    return word == "run" if start == "run" else word != "run" and rest.startswith(start)
