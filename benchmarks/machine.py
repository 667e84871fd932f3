"""The machine and the versions with which a benchmark was measured."""

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import llvmlite.binding

_PACKAGES = (
    "pfdist", "numba", "llvmlite", "numpy", "jax", "jaxlib", "cuthbert", "torch", "particles", "ray"
)  # fmt: skip


def provenance() -> dict[str, str]:
    """Give date, machine (processor, cores, system) and versions."""
    installed = [f"{name} {found}" for name in _PACKAGES if (found := _version(name))]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": f"{_processor()}, {len(os.sched_getaffinity(0))} cores, {_system()}",
        "versions": ", ".join([f"Python {platform.python_version()}", *installed]),
    }


def _processor() -> str:
    """Give the processor's name, its name in the compiler, and its widest vectors."""
    described = _file("/proc/cpuinfo")
    names = [line.partition(":")[2].strip() for line in described if line.startswith("model name")]
    flags = next((line.split() for line in described if line.startswith("flags")), [])
    known = {"avx512f": "AVX-512", "avx2": "AVX2", "sse4_2": "SSE4"}
    vectors = next((name for flag, name in known.items() if flag in flags), platform.machine())
    name = names[0] if names else platform.machine()
    return f"{name} ({llvmlite.binding.get_host_cpu_name()}, {vectors})"


def _system() -> str:
    lines = [line.partition("=") for line in _file("/etc/os-release")]
    names = [value.strip('"') for key, _, value in lines if key == "PRETTY_NAME"]
    return names[0] if names else platform.system()


def _file(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
