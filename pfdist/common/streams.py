"""Keys of streams of noise: hashes of the purpose of the noise. They need no compiler."""

import hashlib
import json
from typing import Any

CHOOSING = ("search", "probe", "shortlist", "online")
"""Purposes of draws that decide between sets. No cost on such draws is reported as proof."""
PROVING = ("comparison", "budget", "bound", "why", "evaluate", "filter", "simulate")
"""Purposes of draws that choose no set. A comparison of several numbers of measurements has the
purpose "budget", so that a later comparison does not use the draws that chose a number."""


def stream_key(*parts: Any) -> int:
    """Hash the purpose of a stream of noise to 64 bits.

    Parameters
    ----------
    *parts : JSON values
        For instance the seed, a phase's name, a generation, measurement times.

    Returns
    -------
    int
        The same for the same parts, always and everywhere.
    """
    text = json.dumps(parts, separators=(",", ":"), sort_keys=True)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little")


def stream_of(purpose: str, seed: int, *parts: Any) -> int:
    """Key of the noise that a purpose, the seed and further parts name.

    Different purposes have different keys, so they share no draw.

    Parameters
    ----------
    purpose : str
        One of `CHOOSING` or `PROVING`.
    seed : int
    *parts : JSON values
    """
    if purpose not in (*CHOOSING, *PROVING):
        raise ValueError(f"purpose must be one of {CHOOSING} or {PROVING}, got {purpose!r}")
    return stream_key(seed, purpose, *parts)
