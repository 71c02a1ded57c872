"""Roles: what a stress changes in a rig, by names that are the same for every kind of rig.

Each kind maps the roles that it has to paths of a scene; a stress on a role that a kind lacks does not apply to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["ROLES", "Role", "Steps", "check_roles"]


@dataclass(frozen=True)
class Steps:
    """Even samples in time: paths of their step [s] and of their number, and the least number that a rig may have."""

    step: str
    count: str
    least: int


#: What a kind says of a role: a path of the scene, or a record where a path is not enough.
Role = str | Steps

#: Every role, and what its path holds. A role of a kind may lead to an option that a scene leaves out.
ROLES: dict[str, str] = {
    "ambient": "photoelectrons of ambient light per second, in one pixel or photodetector with its gate open",
    "baseline": "place (x, y, z) of the light's source in the camera frame, m",
    "fluctuation": "relative rms fluctuation of the emitted energy or power",
    "full-well": "full well, electrons",
    "gain": "gain of the converter, DN per electron",
    "gates": "list of the gates' specs",
    "jitter": "rms timing jitter of a whole slice or record, s",
    "light": "emitted energy of a pulse, J, or mean power, W",
    "motion": "velocity of the platform along (x, y, z), m/s",
    "pitch": "distance of neighbouring lenslets, m",
    "phosphor": "spread of an intensifier's phosphor, 1 σ, pixels",
    "pulse": "spec of the emitted pulse",
    "pulse-width": "full width of the emitted pulse at half its height, s",
    "read-noise": "rms read noise, electrons",
    "sampling": "delays or samples in time, as `Steps`",
    "screen": "spec of the screen before the target",
    "shot-jitter": "rms timing jitter of one pulse against the next, s",
    "stand-off": "distance of the camera's window from its entrance pupil, m",
    "start": "first delay or sample in time, s",
}

#: Roles that are `Steps`; all others are paths.
_STEPS = frozenset({"sampling"})


def check_roles(roles: Mapping[str, Role], kind: str) -> None:
    """Refuse the roles of a kind of rig that name no role, or say of one what it cannot be. Raises ValueError."""
    for name, role in roles.items():
        if name not in ROLES:
            raise ValueError(f"the kind of rig {kind!r} has a role {name!r}, which is none of {sorted(ROLES)}")
        if isinstance(role, Steps) != (name in _STEPS):
            raise ValueError(
                f"the role {name!r} of the kind of rig {kind!r} should be {'Steps' if name in _STEPS else 'a path'}"
            )
