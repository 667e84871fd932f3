"""Keys of streams of noise: hashes of the purpose of the noise. They need no compiler."""

import hashlib
import json
from typing import Any


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
