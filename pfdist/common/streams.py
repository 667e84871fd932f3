"""Keys of noise streams: hashes of the purpose of the noise; this loads no compiler."""

import hashlib
import json
from typing import Any

from pfdist.common.measurement_times import ManySets

CHOOSING = ("search", "shortlist", "online", "particles", "proposal", "explore", "rule")
"""Purposes of draws that decide between sets, rules, numbers of particles, or proposals.

Errors on such draws are never reported as proof.
"""
PROVING = (
    "comparison", "budget", "bound", "why", "evaluate", "filter", "simulate", "backtest", "fit",
    "judge",
)  # fmt: skip
"""Purposes of draws that choose no set.

A comparison of several numbers of measurements has the purpose "budget". So a later comparison does
not use the draws that chose a number.
"""


def stream_key(*parts: Any) -> int:
    """A 64-bit hash of JSON values that identify the noise.

    The values are for instance the seed, a phase's name, a generation, or measurement times. The
    same values give the same key on every machine.
    """
    digest = hashlib.blake2b(digest_size=8)
    for number, part in enumerate(parts):
        digest.update(b"," if number else b"[")
        if isinstance(part, ManySets):  # its text may be hundreds of megabytes
            for place, text in enumerate(part.written()):
                digest.update(f"{',' if place else '['}{text}".encode())
            digest.update(b"]" if len(part) else b"[]")
        else:
            digest.update(json.dumps(part, separators=(",", ":"), sort_keys=True).encode())
    digest.update(b"]" if parts else b"[]")
    return int.from_bytes(digest.digest(), "little")


def stream_of(purpose: str, seed: int, *parts: Any) -> int:
    """The key of the noise for a purpose, a seed, and further parts.

    The purpose is one of `CHOOSING` or `PROVING`. Different purposes have different keys, so they
    do not share draws.
    """
    if purpose not in (*CHOOSING, *PROVING):
        raise ValueError(f"purpose must be one of {CHOOSING} or {PROVING}, got {purpose!r}")
    return stream_key(seed, purpose, *parts)
