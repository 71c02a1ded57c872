"""The sealed split: seeds drawn from a secret key, so that nobody can tune an estimator to the captures of a challenge.

    seed_i = first 63 bits of HMAC-SHA256(key, ["beambench-sealed-1", suite, i])

A seed gives the noise of a capture and, where the suite draws it, its pose; a seed cannot be found from its capture. Tables and
names of files hold the number i, never the seed. The suite's own seeds say how many there are.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import re
from dataclasses import dataclass
from pathlib import Path

from ...scenes.errors import InputError, reason

__all__ = ["Key", "read_key"]

_MOST_BYTES = 4096


@dataclass(frozen=True)
class Key:
    """A secret key. `name` says which one it is, and tells nothing of it."""

    secret: bytes

    @property
    def name(self) -> str:
        """The first 16 hex digits of the key's hash."""
        return hashlib.sha256(b"beambench-sealed-key " + self.secret).hexdigest()[:16]

    def seed(self, suite: str, index: int) -> int:
        """The seed with the number `index` of a suite, below 2⁶³."""
        text = json.dumps(["beambench-sealed-1", suite, index]).encode()
        return int.from_bytes(hmac.digest(self.secret, text, "sha256")[:8], "big") >> 1

    def __repr__(self) -> str:
        return f"Key({self.name})"  # the secret is printed nowhere


def read_key(path: str | Path) -> Key:
    """The key in a file: at least 64 hex digits, that is 256 bits.

    Raises:
        InputError: there is no such file, or it holds anything else.
    """
    place = Path(path).expanduser()
    try:
        with place.open("rb") as file:
            text = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise InputError(
            "The key cannot be read.", where=str(place), value=reason(error),
            next_step="make one with: openssl rand -hex 32 > challenge.key",
        ) from None  # fmt: skip
    digits = text.strip()
    if len(text) > _MOST_BYTES or not re.fullmatch(rb"(?:[0-9a-fA-F]{2}){32,}", digits):
        raise InputError(
            "The file holds no key.", where=str(place), allowed="at least 64 hex digits, on one line",
            next_step="make one with: openssl rand -hex 32 > challenge.key",
        )  # fmt: skip
    return Key(bytes.fromhex(digits.decode()))
