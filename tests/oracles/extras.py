"""Modules and marked tests that are skipped where an extra is not installed."""

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
MODULES = {
    "pfdist/plugins/accelerator": "jax",
    "pfdist/plugins/explorer/server.py": "explore",
    "tests/plugins/accelerator": "jax",
    "tests/crash/test_job_submission.py": "cluster",
    "tests/plugins/explorer/test_browser.py": "explore",
    "tests/plugins/explorer/test_server.py": "explore",
}
"""Modules and folders that need an extra; single tests have the mark ``needs``."""


def missing(extra: str, package: str = "pfdist") -> Iterator[str]:
    """Yield the libraries of an extra of a package that are not installed."""
    for text in requires(package) or ():
        each = Requirement(text)
        if each.marker is None or each.marker.evaluate({"extra": ""}):
            continue  # it is needed without the extra, too
        if not each.marker.evaluate({"extra": extra}):
            continue
        try:
            version(each.name)
        except PackageNotFoundError:
            yield each.name
            continue
        for other in each.extras:
            yield from missing(other, each.name)


def lack_of(extra: str) -> str:
    """Why what needs an extra is skipped; empty if it is installed."""
    lacking = sorted(missing(extra))
    return f"needs pip install -e '.[{extra}]', got no {', '.join(lacking)}" if lacking else ""


def extra_of(path: Path) -> str:
    """The extra that a module needs; empty if it needs none."""
    own = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
    return next((extra for each, extra in MODULES.items() if own.is_relative_to(each)), "")


class SkipsWithoutExtra:
    """A plugin that skips each module of `MODULES` whose extra is not installed.

    pytest calls functions of tests/conftest.py only for what lies in tests/.
    """

    @pytest.hookimpl(tryfirst=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> pytest.CollectReport | None:
        """The report of a skipped module, which is not imported."""
        if not isinstance(collector, pytest.File):
            return None
        extra = extra_of(collector.path)
        if not extra or not (lack := lack_of(extra)):
            return None
        reason = str(collector.path.relative_to(ROOT)), 1, f"Skipped: {lack}"
        return pytest.CollectReport(collector.nodeid, "skipped", reason, [])
