"""Keys of streams of noise: hashes of the purpose of the noise. No compiler is needed."""

import hashlib
import json
from typing import Any

CHOOSING = ("search", "probe", "shortlist", "online", "particles")
"""Purposes of draws that decide between sets, or between numbers of particles.

No error on such draws is reported as proof.
"""
PROVING = ("comparison", "budget", "bound", "why", "evaluate", "filter", "simulate")
"""Purposes of draws that choose no set.

A comparison of several numbers of measurements has the purpose "budget". So a later comparison does
not use the draws that chose a number.
"""


def stream_key(*parts: Any) -> int:
    """A hash of 64 bits of JSON values that say what the noise is for.

    The values are for instance the seed, a phase's name, a generation, or measurement times. The
    same values have the same key, always and everywhere.
    """
    text = json.dumps(parts, separators=(",", ":"), sort_keys=True)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little")


def stream_of(purpose: str, seed: int, *parts: Any) -> int:
    """The key of the noise of a purpose, of the seed, and of other parts.

    The purpose is one of `CHOOSING` or `PROVING`. Different purposes have different keys, so they
    share no draw.
    """
    if purpose not in (*CHOOSING, *PROVING):
        raise ValueError(f"purpose must be one of {CHOOSING} or {PROVING}, got {purpose!r}")
    return stream_key(seed, purpose, *parts)
