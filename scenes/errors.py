"""The error for bad input: what, where, value, allowed values and next step. The command line then exits with 2."""

from __future__ import annotations

__all__ = ["InputError", "other_version", "reason"]


class InputError(ValueError):
    """Input that cannot be used.

    Main arguments:
        what: the problem, one sentence.
    Other arguments:
        where: file, key path or argument that holds it.
        value: the value, shortened where it is long.
        allowed: values that are accepted.
        next_step: a command or action that helps.
    """

    def __init__(
        self, what: str, *, where: str = "", value: object = None, allowed: str = "", next_step: str = ""
    ) -> None:
        self.what, self.where, self.value, self.allowed, self.next_step = what, where, value, allowed, next_step
        super().__init__(str(self))

    def __str__(self) -> str:
        lines = [self.what]
        if self.where:
            lines.append(f"  where:   {self.where}")
        if self.value is not None:
            shown = _shown(self.value)
            lines.append(f"  value:   {shown if len(shown) <= 200 else shown[:197] + '...'}")
        if self.allowed:
            lines.append(f"  allowed: {self.allowed}")
        if self.next_step:
            lines.append(f"  next:    {self.next_step}")
        return "\n".join(lines)

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (self.what, self.where, self.value, self.allowed, self.next_step))


def other_version(what: str, *, where: str, found: object, known: int, older: str) -> InputError:
    """The error of a file of another version of its format.

    Main arguments:
        what: the problem, one sentence. found, known: version of the file, and the one that is read.
        older: next step for a file of an older version; one of a newer version asks for a newer Beambench.
    """
    newer = isinstance(found, int) and not isinstance(found, bool) and found > known
    step = "a newer Beambench wrote it: pip install --upgrade beambench" if newer else older
    return InputError(what, where=where, value=found, allowed=str(known), next_step=step)


def reason(error: BaseException) -> str:
    """What an error says, for people: the system's own words without its number and the path, which stands beside it."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _shown(value: object) -> str:
    try:
        return repr(value)
    except (ValueError, RecursionError):  # a whole number of over 4300 digits, a list that is deeply nested
        return f"(a {type(value).__name__} that cannot be shown)"


def _rebuild(what: str, where: str, value: object, allowed: str, next_step: str) -> InputError:
    return InputError(what, where=where, value=value, allowed=allowed, next_step=next_step)
