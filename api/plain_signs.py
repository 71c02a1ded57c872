"""Signs that a terminal's encoding lacks become plain ones: µ is u, × is x, a dash is -."""

from __future__ import annotations

import codecs

__all__ = ["PLAIN_SIGNS"]

#: Name of the handler of signs that cannot be encoded.
PLAIN_SIGNS = "beambench-plain-signs"

_PLAIN = {
    "µ": "u", "μ": "u", "×": "x", "·": "*", "–": "-", "—": "-", "−": "-", "±": "+-", "°": " deg", "…": "...", "≥": ">=", "≤": "<=",
    "≈": "~", "→": "->", "σ": "sigma", "χ": "chi", "λ": "lambda", "θ": "theta", "τ": "tau", "²": "^2", "³": "^3", "⁻": "^-",
    "½": "1/2", "«": '"', "»": '"', "“": '"', "”": '"', "‘": "'", "’": "'", "√": "sqrt", "∞": "inf", "Å": "A",
    "ö": "oe", "ü": "ue", "ä": "ae",
}  # fmt: skip


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs = error.object[error.start : error.end]
    text = "".join(_PLAIN.get(sign) or sign.encode("ascii", "backslashreplace").decode() for sign in signs)
    return text, error.end


codecs.register_error(PLAIN_SIGNS, _plain)
