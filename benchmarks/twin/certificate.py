"""The certificate of a recording: its clauses, and the verdict of the whole."""

from __future__ import annotations

from dataclasses import dataclass

from .clause import Evidence, Judged

__all__ = ["Certificate"]


@dataclass(frozen=True)
class Certificate:
    """A certificate: its clauses, and what they rest on. `verdict`: "fail" where a clause fails, "cannot tell" where none was
    decided or one of `required` was not, else "pass"."""

    clauses: tuple[Judged, ...]
    evidence: Evidence
    modality: str
    required: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """Of the whole."""
        held = {one.verdict for one in self.clauses}
        return "fail" if "fail" in held else "pass" if "pass" in held and not self.lacking else "cannot tell"

    @property
    def lacking(self) -> list[Judged]:
        """The required clauses that could not be decided, or not be measured."""
        return [one for one in self.clauses if one.clause.name in self.required and one.verdict == "cannot tell"]

    def count(self, verdict: str) -> int:
        """Number of clauses with a verdict, of those that the recording shows anything of."""
        return sum(one.verdict == verdict for one in self.clauses if one.measured)

    @property
    def not_shown(self) -> int:
        """Number of clauses that the recording shows nothing of."""
        return sum(not one.measured for one in self.clauses)
